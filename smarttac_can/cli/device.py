"""The command that runs a device of any EDS: ``device``."""

from __future__ import annotations

from pathlib import Path

import click

from smarttac_can.cli.options import (
    EDS_FILE,
    NODE_ID,
    BusChoice,
    bus_options,
    own_node_id,
    storage_option,
    unconfigured_option,
)
from smarttac_can.cli.plain_errors import naming, plain_errors, warn
from smarttac_can.cli.process import Pace, lockstep_option, run_in_process
from smarttac_can.device.device import Device
from smarttac_can.host.files import StorageFile, read_eds_file
from smarttac_can.nodes.plain_node import PlainNode
from smarttac_can.od.eds import load_eds

_DEFAULT_ID = 1


@click.command(
    epilog="Example: smarttac device --eds some.eds --node-id 5 --interface socketcan "
    "--channel vcan0"
)
@click.option(
    "--eds",
    type=EDS_FILE,
    required=True,
    help="Data sheet or DCF that says what the device has.",
)
@click.option(
    "--node-id", type=NODE_ID, help="Wins over a stored one; without, the stored one or else 1."
)
@unconfigured_option
@bus_options
@click.option("--autostart", is_flag=True, help="OPERATIONAL without waiting for a master.")
@lockstep_option
@storage_option("File for stored parameters; without it they end with the command.")
def device(
    *,
    eds: Path,
    node_id: int | None,
    unconfigured: bool,
    bus: BusChoice,
    autostart: bool,
    lockstep: bool,
    storage: StorageFile | None,
) -> None:
    """Run a device of any EDS, with its values in memory, until Ctrl-C or SIGTERM.

    It has every service whose objects the EDS has, and nothing behind its other objects: what is
    written is read back, and TPDOs carry it.
    """
    with plain_errors():
        fixed = own_node_id(node_id, unconfigured)
        with naming(eds):
            od = load_eds(read_eds_file(eds), _DEFAULT_ID if node_id is None else node_id)
        warn(eds, od.warnings)
        node = PlainNode(Device(od, autostart=autostart, storage=storage, node_id=fixed))
        run_in_process("device", node, bus, Pace(lockstep))
