"""The command that gives devices their node-ID: ``lss``."""

from __future__ import annotations

import click

from smarttac_can.cli.options import (
    NODE_ID,
    BusChoice,
    bus_options,
    closing_network,
    timeout_option,
)
from smarttac_can.cli.plain_errors import plain_errors
from smarttac_can.commissioning.node_ids import Identity, assign_node_id
from smarttac_can.master.errors import NodeNotFoundError


def _identity(_ctx: click.Context, _param: click.Parameter, text: str | None) -> Identity | None:
    if text is None:
        return None
    try:
        numbers = [int(part, 16) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) != len(Identity._fields) or not all(
        0 <= number < 1 << 32 for number in numbers
    ):
        raise click.BadParameter(
            f"{text!r} is not VENDOR:PRODUCT:REVISION:SERIAL, four hexadecimal numbers of 32 bits"
        )
    return Identity(*numbers)


@click.command(
    epilog="\b\nExamples:\n  smarttac lss 12 --store --interface socketcan --channel can0\n"
    "  smarttac lss 12 --identity 0:534D5401:10000:1 --interface socketcan --channel can0"
)
@click.argument("node_id", type=NODE_ID)
@click.option(
    "--identity",
    callback=_identity,
    metavar="V:P:R:S",
    help="Vendor, product, revision and serial number in hexadecimal; without, fastscan.",
)
@click.option("--store", is_flag=True, help="Have the device keep it over a power cut.")
@click.option("--force", is_flag=True, help="Also if a device answers with that node-ID already.")
@bus_options
@timeout_option
def lss(
    node_id: int,
    identity: Identity | None,
    store: bool,
    force: bool,
    bus: BusChoice,
    timeout: float,
) -> None:
    """Give a device the node-ID NODE_ID, by its identity or the first that has none.

    A node-ID that another device answers with is refused.

    A device that has a node-ID already is reset (NMT reset communication) to take the new one.
    """
    with plain_errors():
        with closing_network(bus) as network:
            assigned = assign_node_id(
                network, node_id, identity=identity, store=store, timeout=timeout, force=force
            )
        if not assigned.booted:
            raise NodeNotFoundError(
                f"{assigned.identity} has taken node-ID {node_id}, but sent no boot-up"
            )
    before = "none" if assigned.previous is None else f"{assigned.previous}"
    stored = ", stored" if store else ""
    click.echo(f"{assigned.identity} has node-ID {node_id}{stored}; it had {before}")
