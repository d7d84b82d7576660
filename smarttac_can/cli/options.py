"""Options that several commands share: the bus and the node-ID."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from enum import IntEnum
from functools import reduce, wraps
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import canopen
import click

from smarttac_can.bench.network import TappedNetwork
from smarttac_can.bench.simulation import STIMULATOR_ID
from smarttac_can.cli.plain_errors import one_line, plain_errors
from smarttac_can.device.stored_image import begins_as_image
from smarttac_can.host.bounded_file import read_bounded
from smarttac_can.host.bus import BusError
from smarttac_can.host.drivers import opening, unknown_options
from smarttac_can.host.eds_files import packaged_eds
from smarttac_can.host.file_errors import reason
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.host.storage_file import MAX_BYTES, StorageFile
from smarttac_can.od.cia import UNCONFIGURED

Command = Callable[..., Any]


class FiniteRange(click.FloatRange):
    """Range of floats without nan, which passes click's comparisons, and inf."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number; refuse one that is not finite, or outside the range."""
        number = float(super().convert(value, param, ctx))
        if not isfinite(number):
            self.fail(f"{number} is not a finite number", param, ctx)
        return number


def _eds_path(value: str) -> Path:
    """Find an EDS of any maker, or one of this package by the name of its node."""
    path = Path(value)
    if path.is_dir():
        raise click.BadParameter(f"{value!r} is a directory")
    if path.exists():
        return path
    if value in _PACKAGED_EDS:
        return packaged_eds(f"{value}.eds")
    raise click.BadParameter(f"{value!r} is neither a file nor {' or '.join(_PACKAGED_EDS)}")


_PACKAGED_EDS = ("stimulator", "plate")
EDS_FILE = click.types.FuncParamType(_eds_path)
EDS_FILE.name = "EDS"
OLD_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
NEW_FILE = click.Path(dir_okay=False, path_type=Path)
NODE_ID = click.IntRange(1, 127)
SECONDS = FiniteRange(min=0.01, max=3600)
_OWN_OPTIONS = ("interface", "channel", "bitrate")
_INTEGER = re.compile(r"-?[0-9]+")


timeout_option = click.option(
    "--timeout",
    type=SECONDS,
    default=0.5,
    show_default=True,
    help="Longest wait for an answer in s.",
)


def seed_option(text: str) -> Callable[[Command], Command]:
    """Option of the seed of what is drawn at random, with this help."""
    return click.option(
        "--seed", type=click.IntRange(0, 2**32 - 1), default=1, show_default=True, help=text
    )


def law_option(name: str, laws: type[IntEnum], text: str) -> Callable[[Command], Command]:
    """Option of one of some laws, the first, which is the paper's, unless given; with this help."""
    return click.option(
        name,
        type=click.Choice([law.name.lower() for law in laws]),
        callback=lambda _ctx, _param, chosen: laws[chosen.upper()],
        default=laws(0).name.lower(),
        show_default=True,
        help=text,
    )


unconfigured_option = click.option(
    "--unconfigured",
    is_flag=True,
    help="Wait for LSS to give a node-ID, unless one is stored.",
)


def own_node_id(node_id: int | None, unconfigured: bool) -> int | None:
    """Return the node-ID a person gave; it wins over a stored one.

    Returns
    -------
    int or None
        `UNCONFIGURED` for a device that waits for LSS; None if the stored one, or else the default,
        is to hold.

    Raises
    ------
    click.UsageError
        If a node-ID is given to an unconfigured device.
    """
    if unconfigured and node_id is not None:
        raise click.UsageError(f"--unconfigured has no --node-id, but {node_id} is given")
    return UNCONFIGURED if unconfigured else node_id


def _storage(
    _ctx: click.Context, _param: click.Parameter, value: Path | None
) -> StorageFile | None:
    """Refuse what could not be read at power-on, a store would spoil, or could not be written."""
    if value is None:
        return None
    file = StorageFile(value)
    if not file.path.parent.is_dir():
        raise click.BadParameter(f"{str(file.path.parent)!r} is no directory")
    with plain_errors(), suppress(FileNotFoundError):
        require_image(file.path)
    try:
        file.require_writable()
    except OSError as error:
        raise click.BadParameter(
            f"{value} cannot be written ({reason(error)}), so that neither parameters nor faults "
            "would be kept: name a file in a folder that can be written, or leave --storage out"
        ) from error
    return file


def require_image(path: Path) -> bytes:
    """Read a file that has to hold what a device stored, torn or another's perhaps, or nothing.

    Raises
    ------
    click.ClickException
        If it holds something else.
    OSError
        As for `read_bounded`.
    """
    data = read_bounded(path, MAX_BYTES)
    if not begins_as_image(data):
        raise click.ClickException(one_line(f"{path}: holds nothing that a device has stored"))
    return data


def storage_option(text: str) -> Callable[[Command], Command]:
    """Option of a file for what a device stores, with this help."""
    kind = click.Path(path_type=Path)
    return click.option("--storage", type=kind, metavar="FILE", callback=_storage, help=text)


class BusChoice(NamedTuple):
    """Which bus of python-can; what is None comes from python-can's configuration."""

    interface: str | None
    channel: str | None
    bitrate: int | None
    others: dict[str, Any]
    """Options of the interface by their names there."""

    @property
    def where(self) -> str:
        """Name of the bus for messages."""
        if self.interface is None:
            return "the bus of python-can's configuration"
        return f"{self.interface}:{self.channel}" if self.channel else self.interface

    @property
    def options(self) -> dict[str, Any]:
        """What was given, as `can.Bus` takes it."""
        own = {"interface": self.interface, "channel": self.channel, "bitrate": self.bitrate}
        return {key: value for key, value in own.items() if value is not None} | self.others

    def open(self) -> PythonCanBus:
        """Open the bus.

        Raises
        ------
        BusError
            If it cannot be opened.
        """
        return PythonCanBus(self.interface, self.channel, self.bitrate, **self.others)

    def open_network(self) -> canopen.Network:
        """Open the bus as a network of python-canopen.

        Raises
        ------
        BusError
            If it cannot be opened.
        """
        network = TappedNetwork()
        with opening(self.interface, self.channel, BusError):
            network.connect(**self.options)
        return network


@contextmanager
def closing_network(bus: BusChoice) -> Iterator[canopen.Network]:
    """Open a bus as a network, and leave it on every way out."""
    network = bus.open_network()
    try:
        yield network
    finally:
        network.disconnect()


def with_options(*options: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """Put several options on a command, in the order in which its help shows them."""
    return lambda command: reduce(lambda made, option: option(made), reversed(options), command)


def _bus_option(
    _ctx: click.Context, _param: click.Parameter, values: tuple[str, ...]
) -> dict[str, Any]:
    options = {}
    for value in values:
        key, separator, text = value.partition("=")
        if not separator or not key:
            raise click.BadParameter(f"{value!r} is not KEY=VALUE")
        if key in _OWN_OPTIONS:
            raise click.BadParameter(f"{key!r} has an option of its own")
        options[key] = int(text) if _INTEGER.fullmatch(text) else text
    return options


def bus_options(command: Command) -> Command:
    """Give a command the options of the bus; it is called with ``bus``, a `BusChoice`."""

    @wraps(command)
    def called(
        *args: Any,
        interface: str | None,
        channel: str | None,
        bitrate: int | None,
        bus_options: dict[str, Any],
        **others: Any,
    ) -> Any:
        for text in unknown_options(interface, bus_options):
            raise click.BadParameter(f"--bus-option: {text}")
        bus = BusChoice(interface, channel, bitrate, bus_options)
        return command(*args, bus=bus, **others)

    return with_options(
        click.option("--interface", help="python-can's interface, such as socketcan."),
        click.option("--channel", help="The interface's channel, such as can0."),
        click.option("--bitrate", type=click.IntRange(min=1), help="Bit rate in bit/s."),
        click.option(
            "--bus-option",
            "bus_options",
            multiple=True,
            metavar="KEY=VALUE",
            callback=_bus_option,
            help="Any other option of python-can's interface.",
        ),
    )(called)


stimulator_options = with_options(
    bus_options,
    click.option(
        "--node-id",
        type=NODE_ID,
        default=STIMULATOR_ID,
        show_default=True,
        help="Node-ID of the stimulator.",
    ),
    click.option("--plate-node", type=NODE_ID, help="Node-ID of the plate, if it is a node."),
)
"""Options of a command that reaches a stimulator: those of the bus, and who is asked there."""
