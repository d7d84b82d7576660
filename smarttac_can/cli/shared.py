"""Shared parts of the commands: one-line errors, options of bus and node, files for results."""

from __future__ import annotations

import errno
import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from enum import IntEnum
from functools import cache, reduce, wraps
from math import floor, isfinite, log10
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple, TextIO

import canopen
import click

from smarttac_can.bench.errors import in_shell_words
from smarttac_can.bench.network import TappedNetwork
from smarttac_can.bench.simulation import STIMULATOR_ID
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.bench.traces import require_matplotlib
from smarttac_can.canopen.bus.bus import BusError
from smarttac_can.canopen.device.storage import begins_as_image
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import EDSError, load_eds, node_id_of, read_sections
from smarttac_can.host.drivers import opening, unknown_options
from smarttac_can.host.files import (
    MAX_STORED_BYTES,
    StorageFile,
    packaged_eds,
    read_bounded,
    read_eds,
    read_eds_file,
    reason,
    result_file,
    trouble,
)
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.science.population.compiled import can_compile

_LONGEST_LINE: Final = 500
_MOST_WARNINGS: Final = 20


@contextmanager
def plain_errors(*others: type[Exception]) -> Iterator[None]:
    """Convert errors of bus, bench, EDS, files, killed processes and ``others`` to one line."""
    plain: tuple[type[Exception], ...] = (BenchError, BusError, EDSError, *others)
    try:
        yield
    except KeyboardInterrupt:  # a KeyboardInterrupt of a run is also an error of the bench
        raise
    except plain as error:
        texts = map(in_shell_words, (error, *getattr(error, "__notes__", ())))
        raise click.ClickException(one_line("; ".join(filter(None, texts)))) from error
    except BrokenProcessPool as error:
        raise click.ClickException("a process that shared the work was killed") from error
    except BrokenPipeError:  # click ends without a word, as for any reader that leaves
        raise
    except OSError as error:
        raise click.ClickException(one_line(trouble(error))) from error


@contextmanager
def naming(file: str | Path, *others: type[Exception]) -> Iterator[None]:
    """Prefix the errors of an EDS, and ``others``, with the name of the file."""
    wrong: tuple[type[Exception], ...] = (EDSError, *others)
    try:
        yield
    except wrong as error:
        raise click.ClickException(one_line(f"{file}: {error}")) from error


def warn(file: str | Path, warnings: Sequence[str]) -> None:
    """Print the warnings about a file on stderr: the first 20, and the number of the others."""
    for warning in warnings[:_MOST_WARNINGS]:
        click.echo(one_line(f"{file}: {warning}"), err=True)
    if more := len(warnings[_MOST_WARNINGS:]):
        click.echo(one_line(f"{file}: {more} more warnings"), err=True)


def refuse_own_files(own: Iterable[Path], others: Iterable[Path | None], whose: str) -> None:
    """Refuse a command that would write another result into one of its own files."""
    taken = {file.resolve() for file in own}
    for other in others:
        if other is not None and other.resolve() in taken:
            raise click.UsageError(f"{other} is a file of {whose} itself: choose another")


def need_matplotlib() -> None:
    """Refuse a command that draws before its work starts, if matplotlib is missing."""
    with plain_errors():
        require_matplotlib()


def warn_without_numba(besides: str = "") -> None:
    """Warn that what numba would compile takes long; `besides` is what else is slower then."""
    if not can_compile():
        click.echo(
            f"numba is not installed: it takes some 30 times as long{besides}: "
            "pip install 'smarttac-can[campaign]'",
            err=True,
        )


def in_steps(value: float, step: float) -> str:
    """Return a number with as many decimals as a step of it has: 32.2 for 32.2034 and 0.2.

    Parameters
    ----------
    value
        Number.
    step
        Step above 0 below which a difference has no meaning, such as a resolution.
    """
    return f"{value:.{max(0, -floor(log10(step)))}f}"


def one_line(text: object) -> str:
    """Return a line of at most 500 printable characters, as files may hold control characters."""
    line = " ".join(str(text).split())
    if len(line) > _LONGEST_LINE:
        line = f"{line[:_LONGEST_LINE]}..."
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


Command = Callable[..., Any]


class FiniteRange(click.FloatRange):
    """Range of finite floats: without nan, which passes click's comparisons, and inf."""

    name = "number"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number; refuse one that is not finite, or outside the range."""
        number = float(super().convert(value, param, ctx))
        if not isfinite(number):
            self.fail(f"{number} is not a finite number", param, ctx)
        return number


class WholeRange(click.IntRange):
    """Range of integers, which calls a text no integer instead of no "integer range"."""

    name = "integer"


def _eds_path(value: str) -> Path:
    """Return the path of an EDS file, or of a packaged one by the name of its node."""
    path = Path(value)
    if path.is_dir():
        raise click.BadParameter(f"{value!r} is a directory")
    if path.exists():
        return path
    if value in _PACKAGED_EDS:
        return packaged_eds(f"{value}.eds")
    raise click.BadParameter(f"{value!r} is neither a file nor {' or '.join(_PACKAGED_EDS)}")


_PACKAGED_EDS = ("stimulator", "plate")
PACKAGED = tuple(f"{name}.eds" for name in _PACKAGED_EDS)
EDS_FILE = click.types.FuncParamType(_eds_path)
EDS_FILE.name = "EDS"
OLD_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
NEW_FILE = click.Path(dir_okay=False, path_type=Path)
NODE_ID = WholeRange(1, 127)
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
    help="The nodes run with --lockstep: this command produces SYNC, and waits for each cycle.",
)


def seed_option(text: str) -> Callable[[Command], Command]:
    """Return the option of the seed of random draws, with this help."""
    return click.option(
        "--seed", type=WholeRange(0, 2**32 - 1), default=1, show_default=True, help=text
    )


def law_option(
    name: str, laws: type[IntEnum], text: str, *, multiple: bool = False
) -> Callable[[Command], Command]:
    """Return the option of a law, with this help; the default is the first, that of the paper.

    With `multiple` it may be given again, and gives a list of laws.
    """
    first = laws(0).name.lower()

    def chosen_of(_ctx: click.Context, _param: click.Parameter, chosen: Any) -> object:
        return [laws[one.upper()] for one in chosen] if multiple else laws[chosen.upper()]

    return click.option(
        name,
        type=click.Choice([law.name.lower() for law in laws]),
        multiple=multiple,
        callback=chosen_of,
        default=[first] if multiple else first,
        show_default=True,
        help=text,
    )


unconfigured_option = click.option(
    "--unconfigured",
    is_flag=True,
    help="Wait for LSS to give a node-ID, unless one is stored.",
)


def load_file(file: Path, node_id: int | None = None, absent: int = 1) -> ObjectDictionary:
    """Load an EDS, or a DCF, which is not taken for another node than its own.

    Parameters
    ----------
    node_id
        Node-ID that the user gave; None for that of a DCF.
    absent
        Node-ID for an EDS if the user gave none.

    Raises
    ------
    click.ClickException
        The file cannot be interpreted, or is the DCF of another node.
    """
    return _loaded(file, node_id, absent)[0]


def _loaded(file: Path, node_id: int | None, absent: int) -> tuple[ObjectDictionary, int | None]:
    """Return the object dictionary, and the node-ID of the user or the DCF."""
    text = read_eds_file(file)
    with naming(file, ValueError):
        own = node_id_of(read_sections(text, []), node_id)
        return load_eds(text, absent if own is None else own), own


@cache
def _own_identities() -> frozenset[tuple[int, int]]:
    return frozenset(_kind(load_eds(read_eds(name), 1)) for name in PACKAGED)


def _kind(od: ObjectDictionary) -> tuple[int, int]:
    """Return vendor-ID and product code."""
    return od.number(cia.IDENTITY, 1), od.number(cia.IDENTITY, 2)


def is_ours(od: ObjectDictionary) -> bool:
    """Return whether an EDS is that of a stimulator or plate, by vendor-ID and product code."""
    return _kind(od) in _own_identities()


def load_own(
    file: Path, node_id: int | None, unconfigured: bool, absent: int = 1
) -> tuple[ObjectDictionary, int | None]:
    """Load the EDS or DCF of a device to run.

    Parameters
    ----------
    node_id, unconfigured
        Node-ID that the user gave, and whether the device waits for LSS.
    absent
        Node-ID for an EDS if the user gave none.

    Returns
    -------
    ObjectDictionary
        Objects of the device.
    int or None
        Node-ID of the user or the DCF, which overrides a stored one; `cia.UNCONFIGURED` for a
        device that waits for LSS; None for the stored node-ID, or else the default.

    Raises
    ------
    click.UsageError
        A node-ID is given for an unconfigured device.
    click.ClickException
        The file cannot be interpreted, or is the DCF of another node.
    """
    if unconfigured and node_id is not None:
        raise click.UsageError(f"--unconfigured has no --node-id, but {node_id} is given")
    od, own = _loaded(file, node_id, absent)
    if unconfigured and own is not None:
        raise click.UsageError(
            f"--unconfigured has no node-ID, but {file} is the DCF of node {own}: give its EDS"
        )
    return od, cia.UNCONFIGURED if unconfigured else own


def _storage(
    _ctx: click.Context, _param: click.Parameter, value: Path | None
) -> StorageFile | None:
    """Return the storage file; refuse one that is unreadable, not writable or not a storage."""
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
    """Read a file that is empty, or holds the storage of a device, perhaps torn or of another one.

    Raises
    ------
    click.ClickException
        It holds something else.
    OSError
        As for `read_bounded`.
    """
    data = read_bounded(path, MAX_STORED_BYTES)
    if not begins_as_image(data):
        raise click.ClickException(one_line(f"{path}: holds nothing that a device has stored"))
    return data


def storage_option(text: str) -> Callable[[Command], Command]:
    """Return the option of a file for the storage of a device, with this help."""
    kind = click.Path(path_type=Path)
    return click.option("--storage", type=kind, metavar="FILE", callback=_storage, help=text)


class BusChoice(NamedTuple):
    """A bus of python-can; None means the value in python-can's configuration."""

    interface: str | None
    channel: str | None
    bitrate: int | None
    others: dict[str, Any]
    """Options of the interface, by their names in python-can."""

    @property
    def where(self) -> str:
        """Name of the bus for messages."""
        if self.interface is None:
            return "the bus of python-can's configuration"
        return f"{self.interface}:{self.channel}" if self.channel else self.interface

    @property
    def options(self) -> dict[str, Any]:
        """Options that were given, in the form for `can.Bus`."""
        own = {"interface": self.interface, "channel": self.channel, "bitrate": self.bitrate}
        return {key: value for key, value in own.items() if value is not None} | self.others

    def open(self) -> PythonCanBus:
        """Open the bus.

        Raises
        ------
        BusError
            It cannot be opened.
        """
        return PythonCanBus(self.interface, self.channel, self.bitrate, **self.others)


@contextmanager
def closing_network(bus: BusChoice) -> Iterator[canopen.Network]:
    """Open a bus as a network, and disconnect at the end of the block, also after an error.

    Raises
    ------
    BusError
        It cannot be opened.
    """
    network = TappedNetwork()
    with opening(bus.interface, bus.channel, BusError):
        network.connect(**bus.options)
    try:
        yield network
    finally:
        network.disconnect()


def with_options(*options: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """Return a decorator that adds several options, in the order of the help."""
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
    """Add the options of the bus to a command, which gets ``bus``, a `BusChoice`."""

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
        click.option("--bitrate", type=WholeRange(min=1), help="Bit rate in bit/s."),
        click.option(
            "--bus-option",
            "bus_options",
            multiple=True,
            metavar="KEY=VALUE",
            callback=_bus_option,
            help="Any other option of python-can's interface.",
        ),
    )(called)


def require_two_nodes(node_id: int, plate_node: int | None) -> None:
    """Refuse a plate with the node-ID of its stimulator.

    Raises
    ------
    click.UsageError
        The node-IDs are the same.
    """
    if plate_node == node_id:
        raise click.UsageError(f"--plate-node {plate_node} is the --node-id of the stimulator")


class StimulatorChoice(NamedTuple):
    """A stimulator on a bus."""

    bus: BusChoice
    node_id: int
    plate_node: int | None
    """Node-ID of the plate; None if it is inside, or unknown."""

    def connect(self, *, lockstep: bool = False, timeout: float | None = None) -> Stimulator:
        """Connect to it, and raise as `Stimulator.connect`."""
        return Stimulator.connect(
            node_id=self.node_id,
            plate_node_id=self.plate_node,
            lockstep=lockstep,
            timeout=timeout,
            **self.bus.options,
        )


def stimulator_options(command: Command) -> Command:
    """Add the options of bus and node-IDs to a command, which gets ``at``, a `StimulatorChoice`."""

    @wraps(command)
    def called(
        *args: Any, bus: BusChoice, node_id: int, plate_node: int | None, **others: Any
    ) -> Any:
        require_two_nodes(node_id, plate_node)
        return command(*args, at=StimulatorChoice(bus, node_id, plate_node), **others)

    return with_options(
        bus_options,
        click.option(
            "--node-id",
            type=NODE_ID,
            default=STIMULATOR_ID,
            show_default=True,
            help="Node-ID of the stimulator.",
        ),
        click.option("--plate-node", type=NODE_ID, help="Node-ID of the plate node, if any."),
    )(called)


# Files and folders for results: nothing is replaced without ``--force``.
#
# A command that would replace something is refused before its work starts. New results replace old
# ones only after all of them are written, so a run that fails leaves the old results unchanged.


_FORCE: Final = f"{__name__}.force"
_MOST_NAMED: Final = 3


class _ResultPath(click.Path):
    """Path for results, refused if it is not empty, unless ``--force`` was given."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path; refuse one that is not empty."""
        path = super().convert(value, param, ctx)
        assert isinstance(path, Path)
        if ctx is not None and not ctx.meta.get(_FORCE) and (held := _held(path)):
            raise click.ClickException(held)
        return path


def _held(path: Path) -> str:
    """Return what results would replace at a path; empty for nothing, and for a device."""
    if path.is_dir():
        # Ignore hidden files, which no user made: .gitkeep, .DS_Store.
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
    """Return the option to replace older results, with this help; the command does not get it."""
    return click.option(
        "--force", is_flag=True, is_eager=True, expose_value=False, callback=_take_force, help=text
    )


result_path = _ResultPath(dir_okay=False, writable=True, path_type=Path)
"""Parameter type of a file for results; the command needs a `force_option`."""
result_folder_path = _ResultPath(file_okay=False, path_type=Path)
"""Parameter type of a folder for results; the command needs a `force_option`."""


def json_options(
    *, bare: bool = False, force: str = "Replace older results."
) -> Callable[[Command], Command]:
    """Return the options of a file for results and of replacing it; the command gets ``json_file``.

    With `bare`, for a command that prints only its results, ``--json`` without a file means stdout.
    """
    own: dict[str, Any] = {"help": "File for the results; - is stdout."}
    if bare:
        text = "File for the results; - or no name is stdout."
        own = {"is_flag": False, "flag_value": "-", "help": text}
    option = click.option("--json", "json_file", type=result_path, **own)
    return with_options(option, force_option(force))


Report = Callable[[object, Iterable[str]], None]
"""Function that writes results to their file, and lines to stdout unless that is the file."""


@contextmanager
def reporting(json_file: Path | None, *others: type[Exception]) -> Iterator[Report]:
    """Open the file for the results before the run, and show errors as `plain_errors` does."""
    with plain_errors(*others), ExitStack() as stack:
        file: TextIO | None = None
        if json_file is not None:
            stdout = json_file == Path("-")
            file = sys.stdout if stdout else stack.enter_context(result_file(json_file))

        def report(results: object, lines: Iterable[str]) -> None:
            if file is not None:
                click.echo(json.dumps(results, indent=2), file)
            if file is not sys.stdout and (text := "\n".join(lines)):
                click.echo(text)

        yield report


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Create a folder if it does not exist, and remove it after the block if it is empty."""
    new = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileNotFoundError:  # a file system that only its kernel fills
        text = "no folder can be made there"
        raise PermissionError(errno.EACCES, text, str(folder)) from None
    try:
        yield
    finally:
        if new:
            with suppress(OSError):  # it is not empty
                folder.rmdir()


@contextmanager
def result_folder(folder: Path, names: Iterable[str]) -> Iterator[Path]:
    """Yield an empty folder whose files replace old results after the block.

    Parameters
    ----------
    folder
        Folder of the results; created if it does not exist.
    names
        Names of all files that the results may have. Old files with these names that were not
        written again are removed; files with other names stay.

    Yields
    ------
    Path
        Folder inside it into which the results are to be written.

    Raises
    ------
    OSError
        It cannot be written.
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
