"""The command ``smarttac`` and its subcommands."""

from __future__ import annotations

import click

from smarttac_can import __version__
from smarttac_can.cli.calibrate import calibrate
from smarttac_can.cli.campaign import campaign
from smarttac_can.cli.conformance import conform
from smarttac_can.cli.device import device
from smarttac_can.cli.eds import eds
from smarttac_can.cli.faults import faults, soak
from smarttac_can.cli.fmeda import fmeda
from smarttac_can.cli.hostile import hostile
from smarttac_can.cli.jitter import jitter
from smarttac_can.cli.lss import lss
from smarttac_can.cli.nodes import node, plate
from smarttac_can.cli.record import record
from smarttac_can.cli.replay import replay
from smarttac_can.cli.reproduction import demo, report, reproduce
from smarttac_can.cli.scan import scan
from smarttac_can.cli.selftest import selftest
from smarttac_can.cli.status import reset, status
from smarttac_can.cli.watch import watch
from smarttac_can.host.process_signals import sigterm_interrupts

EXAMPLE = """\b
Examples:
  smarttac demo
  smarttac node --interface socketcan --channel vcan0
"""


@click.group(epilog=EXAMPLE, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
@click.pass_context
def main(context: click.Context) -> None:
    """SMARTTAC as a CANopen instrument: nodes, plate simulator and the paper's experiments."""
    context.with_resource(sigterm_interrupts())


for command in (
    demo, reproduce, report, node, plate, device, conform, scan, lss, eds, jitter, faults,
    soak, hostile, fmeda, campaign, status, reset, watch, record, replay, selftest, calibrate,
):  # fmt: skip
    main.add_command(command)
