"""The command ``smarttac`` and its subcommands, grouped in families.

The module of a command is imported only when the command is called; `--help` imports none of them.
"""

from __future__ import annotations

from importlib import import_module
from typing import Final, NamedTuple

import click

from smarttac_can import __version__, build
from smarttac_can.host.process_signals import endings_interrupt

EXAMPLE = """\b
Examples:
  smarttac demo
  smarttac node --interface socketcan --channel vcan0
"""


class _Command(NamedTuple):
    """Module of a command, and its one-line description."""

    module: str
    does: str


FAMILIES: Final = {
    "Use": {
        "demo": _Command("experiments", "Run the paper's experiments without hardware."),
        "reproduce": _Command("experiments", "Run experiments, and compare with the paper."),
        "report": _Command("experiments", "Draw the pictures of an older run anew."),
        "campaign": _Command("experiments", "Compare the laws on thousands of random fingers."),
        "fit-finger": _Command("fit_finger", "Fit a fingertip to a recording, with limits."),
        "node": _Command("nodes", "Run the stimulator node."),
        "plate": _Command("nodes", "Run the plate node, simulated or with hardware."),
    },
    "Bench": {
        "status": _Command("bench", "Show state, faults and levels of a stimulator."),
        "reset": _Command("bench", "Reset the latched fault of a stimulator."),
        "watch": _Command("bench", "Show a stimulator live."),
        "panel": _Command("bench", "Show a stimulator live in a browser, or a simulated one."),
        "record": _Command("recording", "Record a stimulator while others drive it."),
        "log": _Command("log", "Show the frames of a log or a bus in plain text."),
        "calibrate": _Command("bench", "Calibrate the force gauges by known weights."),
        "selftest": _Command("bench", "Check timing, gauges, pick-up and resonance."),
    },
    "Commission": {
        "scan": _Command("commission", "List the devices on a bus."),
        "lss": _Command("commission", "Give a device its node-ID."),
        "eds": _Command("commission", "Check an EDS; make a DBC or DCF of it; load a DCF."),
        "sdo": _Command("sdo", "Read or write one object of a device."),
        "device": _Command("nodes", "Run a simulated device of any EDS."),
        "conform": _Command("commission", "Test a CANopen device by its EDS."),
    },
    "Verify": {
        "jitter": _Command("jitter", "Measure the timing of the loop on this machine and bus."),
        "replay": _Command("recording", "Recompute a log, and compare what was sent."),
    },
}
"""The commands in the order of the help."""
_COMMANDS: Final = {name: of for commands in FAMILIES.values() for name, of in commands.items()}


class _Families(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - as click calls it
        """Return the names of the commands."""
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import a command; return None if there is none with that name."""
        if cmd_name not in _COMMANDS:
            return None
        module = import_module(f"{__name__}.{_COMMANDS[cmd_name].module}")
        command: click.Command = getattr(module, cmd_name.replace("-", "_"))
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write the commands of each family, a line each."""
        width = max(map(len, _COMMANDS))
        for family, commands in FAMILIES.items():
            with formatter.section(family):
                formatter.write_dl(
                    [(name.ljust(width), command.does) for name, command in commands.items()]
                )


@click.group(
    cls=_Families, epilog=EXAMPLE, context_settings={"help_option_names": ["-h", "--help"]}
)
@click.version_option(f"{__version__} ({build()})")
@click.pass_context
def main(context: click.Context) -> None:
    """SMARTTAC as a CANopen instrument: nodes, plate simulator and the paper's experiments."""
    context.with_resource(endings_interrupt())
