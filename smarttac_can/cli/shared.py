"""What commands share: errors in one line, options of bus and node, files for results."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from enum import IntEnum
from functools import reduce, wraps
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple, TextIO

import canopen
import click

from smarttac_can.bench.errors import in_shell_words
from smarttac_can.bench.network import TappedNetwork
from smarttac_can.bench.simulation import STIMULATOR_ID
from smarttac_can.bench.traces import require_matplotlib
from smarttac_can.device.storage import begins_as_image
from smarttac_can.host.bus import BusError
from smarttac_can.host.drivers import opening, unknown_options
from smarttac_can.host.files import (
    MAX_STORED_BYTES,
    StorageFile,
    packaged_eds,
    read_bounded,
    reason,
    result_file,
    trouble,
)
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.master.errors import BenchError
from smarttac_can.od.cia import UNCONFIGURED
from smarttac_can.od.eds import EDSError

_LONGEST_LINE: Final = 500
_MOST_WARNINGS: Final = 20


@contextmanager
def plain_errors(*others: type[Exception]) -> Iterator[None]:
    """Turn the errors of bus, bench, EDS, files, killed processes and others into one line."""
    plain: tuple[type[Exception], ...] = (BenchError, BusError, EDSError, *others)
    try:
        yield
    except KeyboardInterrupt:  # that of a run is an error of the bench as well
        raise
    except plain as error:
        texts = map(in_shell_words, (error, *getattr(error, "__notes__", ())))
        raise click.ClickException(one_line("; ".join(filter(None, texts)))) from error
    except BrokenProcessPool as error:
        raise click.ClickException("a process that shared the work was killed") from error
    except OSError as error:
        raise click.ClickException(one_line(trouble(error))) from error


@contextmanager
def naming(file: str | Path, *others: type[Exception]) -> Iterator[None]:
    """Put the name of the file in front of what is wrong with an EDS, or of other errors."""
    wrong: tuple[type[Exception], ...] = (EDSError, *others)
    try:
        yield
    except wrong as error:
        raise click.ClickException(one_line(f"{file}: {error}")) from error


def warn(file: str | Path, warnings: Sequence[str]) -> None:
    """Say on stderr what is odd about a file; beyond 20 lines only how many more there are."""
    for warning in warnings[:_MOST_WARNINGS]:
        click.echo(one_line(f"{file}: {warning}"), err=True)
    if more := len(warnings[_MOST_WARNINGS:]):
        click.echo(one_line(f"{file}: {more} more warnings"), err=True)


def need_matplotlib() -> None:
    """Refuse a command that draws, before its work begins, if matplotlib is missing."""
    with plain_errors():
        require_matplotlib()


def one_line(text: object) -> str:
    """Make a line of at most 500 characters that a terminal only shows, whatever a file holds."""
    line = " ".join(str(text).split())
    if len(line) > _LONGEST_LINE:
        line = f"{line[:_LONGEST_LINE]}..."
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


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


lockstep_option = click.option(
    "--lockstep",
    is_flag=True,
    help="Let SYNC be the only clock: for simulated time at any pace.",
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
    data = read_bounded(path, MAX_STORED_BYTES)
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

# Files and folders for results: nothing that is there is replaced without ``--force``.
#
# What would be replaced is refused before the work begins. New results take the place of old ones
# when all of them are written, so that a run that fails leaves the old ones as they were.


_FORCE: Final = f"{__name__}.force"
_MOST_NAMED: Final = 3


class _ResultPath(click.Path):
    """Path for results, refused if it holds something, unless ``--force`` was given."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path; refuse one that holds something."""
        path = super().convert(value, param, ctx)
        assert isinstance(path, Path)
        if ctx is not None and not ctx.meta.get(_FORCE) and (held := _held(path)):
            raise click.ClickException(held)
        return path


def _held(path: Path) -> str:
    """Say what a path holds that results would replace; empty for nothing, and for a device."""
    if path.is_dir():
        # What is hidden is not the work of a person: .gitkeep, .DS_Store.
        names = sorted(file.name for file in path.iterdir() if not file.name.startswith("."))
        if not names:
            return ""
        more = [f"{len(names) - _MOST_NAMED} more"] if len(names) > _MOST_NAMED else []
        listed = ", ".join([*names[:_MOST_NAMED], *more])
        return (
            f"the folder {path} is not empty ({listed}): choose another folder, or replace older "
            "results in it with --force"
        )
    if path.is_file() and path.stat().st_size:
        return f"{path} exists: choose another file, or replace it with --force"
    return ""


def _take_force(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    ctx.meta[_FORCE] = value


def force_option(text: str = "Replace older results.") -> Callable[[Command], Command]:
    """Option that lets older results be replaced, with this help; the command is not told of it."""
    return click.option(
        "--force", is_flag=True, is_eager=True, expose_value=False, callback=_take_force, help=text
    )


result_path = _ResultPath(dir_okay=False, writable=True, path_type=Path)
"""Parameter type of a file for results; the command needs a `force_option`."""
result_folder_path = _ResultPath(file_okay=False, path_type=Path)
"""The same for a folder."""


def json_options(
    *, bare: bool = False, force: str = "Replace older results."
) -> Callable[[Command], Command]:
    """Options of a file for results, and of replacing it; the command is called with ``json_file``.

    With `bare`, for a command whose results are all that it prints, ``--json`` alone is stdout.
    """
    own: dict[str, Any] = {"help": "File for the results; - is stdout."}
    if bare:
        text = "File for the results; - is stdout, and so is none."
        own = {"is_flag": False, "flag_value": "-", "help": text}
    option = click.option("--json", "json_file", type=result_path, **own)
    return with_options(option, force_option(force))


def opened_results(stack: ExitStack, json_file: Path | None) -> TextIO | None:
    """Open the file for the results before the run; None for none."""
    if json_file is None:
        return None
    if json_file == Path("-"):
        return sys.stdout
    return stack.enter_context(result_file(json_file))


def report_results(results: object, lines: Iterable[str], file: TextIO | None) -> None:
    """Write results to their file, and lines to stdout unless it has the results."""
    if file is not None:
        click.echo(json.dumps(results, indent=2), file)
    if file is not sys.stdout and (text := "\n".join(lines)):
        click.echo(text)


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Make a folder if there is none; if nothing is in it after the block, it is gone again."""
    new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        if new:
            with suppress(OSError):  # it has results
                folder.rmdir()


@contextmanager
def result_folder(folder: Path, names: Iterable[str]) -> Iterator[Path]:
    """Give an empty folder whose files take the place of old results when all of them are there.

    Parameters
    ----------
    folder
        Where they are to be; made if it does not exist.
    names
        Of all files that such results may have: old ones that were not made anew are removed.
        Files of other names stay.

    Yields
    ------
    Path
        A folder inside it, where the results are to be written.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with ExitStack() as stack:
        stack.enter_context(_made(folder))
        try:
            part = stack.enter_context(TemporaryDirectory(prefix=".part-", dir=folder))
        except OSError as error:
            error.filename = str(folder)
            raise
        try:
            yield Path(part)
        except OSError as error:
            if error.errno and error.filename is None:  # as on a full disk
                error.filename = str(folder)
            raise
        made = list(Path(part).iterdir())
        for name in {*names} - {file.name for file in made}:
            (folder / name).unlink(missing_ok=True)
        for file in made:
            file.replace(folder / file.name)
