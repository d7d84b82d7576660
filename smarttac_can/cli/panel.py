"""The command ``panel``: a stimulator in a browser."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack, suppress
from importlib.util import find_spec
from ipaddress import ip_address
from secrets import token_urlsafe
from typing import Final

import click

from smarttac_can.bench import Stimulator, plate_od, stimulator_od
from smarttac_can.cli.shared import BusChoice, plain_errors, stimulator_options
from smarttac_can.watch.listener import Listener
from smarttac_can.watch.watcher import Watcher

_BIT_RATE: Final = 1_000_000


@click.command(
    epilog="\b\nExamples:\n  smarttac panel\n"
    "  smarttac panel --interface socketcan --channel can0 --plate-node 33 --drive"
)
@stimulator_options
@click.option("--drive", is_flag=True, help="Start the nodes, and let one page drive them.")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address of this computer at which pages reach it.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8033,
    show_default=True,
    help="TCP port; 0 is any that is free.",
)
def panel(
    *, bus: BusChoice, node_id: int, plate_node: int | None, drive: bool, host: str, port: int
) -> None:
    """Show a stimulator live in a browser: plate, charts, state and faults.

    Without --interface it is a simulated bench in this process, and the mouse is the finger. The
    address that is printed has a token: who has it may drive. One page drives at a time, and 0.8 s
    after it falls silent the plate is at 0 V.
    """
    if bus.interface is None and (drive or bus.options or plate_node is not None):
        raise click.UsageError("a bus needs --interface; without one a bench is simulated")
    if find_spec("aiohttp") is None:
        raise click.ClickException("panel needs aiohttp: pip install 'smarttac-can[panel]'")
    from smarttac_can.panel.instrument import BusInstrument, SimulatedBench  # noqa: PLC0415
    from smarttac_can.panel.server import Panel, serve  # noqa: PLC0415 - aiohttp is an extra

    with suppress(ValueError):
        if ip_address(host).is_unspecified:
            raise click.BadParameter(f"--host {host} is every address: name one")
    token = token_urlsafe(16)

    def told(port: int) -> None:
        place = f"[{host}]" if ":" in host else host
        click.echo(f"panel of {instrument.where}: http://{place}:{port}/#{token}")
        click.echo("Ctrl-C ends it")

    with plain_errors(), ExitStack() as stack:
        instrument: SimulatedBench | BusInstrument
        if bus.interface is None:
            instrument = SimulatedBench()
        else:
            watcher = Watcher(
                stimulator_od(node_id),
                None if plate_node is None else plate_od(plate_node),
                bit_rate=bus.bitrate or _BIT_RATE,
            )
            listener = stack.enter_context(Listener(bus.open))
            stimulator = None
            if drive:
                stimulator = stack.enter_context(
                    Stimulator.connect(node_id=node_id, plate_node_id=plate_node, **bus.options)
                )
            od = stimulator_od(node_id)
            instrument = BusInstrument(bus.where, od, watcher, listener, stimulator)
        stack.enter_context(instrument)
        with suppress(KeyboardInterrupt):
            asyncio.run(serve(Panel(instrument, token, host), host, port, told))
