"""Commands that run a node on a bus: ``node``, ``plate`` and ``device``."""

from __future__ import annotations

import os
import runpy
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial, wraps
from pathlib import Path
from secrets import randbelow
from typing import Any, Final, NamedTuple

import click
from click.core import ParameterSource

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID, know_nulls, plate_od
from smarttac_can.canopen.bus.bus import BusError, QueueFullError
from smarttac_can.canopen.commissioning.dcf import find_entry
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.canopen.od.data_types import REAL
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds_check import check_pdos
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.cli.shared import (
    EDS_FILE,
    NODE_ID,
    OLD_FILE,
    BusChoice,
    Command,
    WholeRange,
    bus_options,
    load_own,
    naming,
    one_line,
    plain_errors,
    require_two_nodes,
    seed_option,
    storage_option,
    unconfigured_option,
    warn,
    with_options,
)
from smarttac_can.host.files import (
    FaultFile,
    StorageFile,
    packaged_eds,
    read_lines,
    read_numbers,
    reason,
)
from smarttac_can.host.front_ends import FrontEndError, opened_front_end
from smarttac_can.host.process_signals import stop_on_signals
from smarttac_can.host.realtime import (
    collecting_between_cycles,
    keep_processors_awake,
    request_real_time,
    request_short_slices,
)
from smarttac_can.host.reconnecting_bus import ReconnectingBus
from smarttac_can.host.runner import run_node
from smarttac_can.host.terminal import LineWriter
from smarttac_can.instrument.nodes.device_node import DeviceNode
from smarttac_can.instrument.nodes.plate_block import TICK_MASK, PlateBlock
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.science.plant.finger import GIVEN_RANGES, Trajectory
from smarttac_can.vocabulary.meanings import LIFTED, RECORDED, STROKE
from smarttac_can.vocabulary.plate import TimedPlate
from smarttac_can.vocabulary.signals import SHORT_DEADLINE_MS
from smarttac_can.vocabulary.states import Mode
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

_DOUBLE: Final = 1 << Watchdog.DOUBLE


class StateLines:
    """Print the state of a node, as an `Observer` of its run: a line for every change.

    Parameters
    ----------
    name
        Name of the node in the lines.
    where
        Name of the bus.
    node
        Node to observe.
    write
        Function that takes a line, and does not block.
    meanwhile
        Function that is called when the run has time, at least every 50 ms.
    """

    def __init__(
        self,
        name: str,
        where: str,
        node: DeviceNode,
        write: Callable[[str], None],
        meanwhile: Callable[[], None] | None = None,
    ) -> None:
        self._name = name
        self._where = where
        self._write = write
        self._device = node.device
        self._mode = node.od["Mode display"] if isinstance(node, StimulatorNode) else None
        self._diagnosis = _diagnosis(node.od) if isinstance(node, StimulatorNode) else None
        self._plate = node.block if isinstance(node, PlateNode) else None
        self._shut_down = "stopped" if type(node) is DeviceNode else "stopped at 0 V"
        self._shown = self._now()
        self._bit_rate: int | None = None
        self._collision = 0
        self._meanwhile = meanwhile

    def started(self) -> None:
        """Print that the node is ready."""
        self._shown = self._now()
        if self._device.storage_torn:
            self._write(
                f"{self._title} has its defaults: the --storage is torn, or of another device"
            )
        self._write(f"{self._title} ready on {self._where}")

    def follow(self) -> None:
        """Print what has changed."""
        if self._meanwhile is not None:
            self._meanwhile()
        if self._device.bit_rate != self._bit_rate:
            self._bit_rate = self._device.bit_rate
            self._write(
                f"{self._title} {self._bit_rate} kbit/s by LSS: the bus here stays as it is, set "
                "its bit rate and restart"
            )
        if self._device.collision != self._collision:
            self._collision = self._device.collision
            self._write(f"{self._title} {self._double}")
        now = self._now()
        if now == self._shown:
            return
        state, mode, reason = now
        state_before, mode_before, reason_before = self._shown
        self._shown = now
        if state != state_before:
            self._write(f"{self._title} {state.name.lower().replace('_', '-')}")
        if mode != mode_before:
            self._write(f"{self._title} mode {Mode(mode).name.lower()}")
        if reason and reason != reason_before:
            self._write(f"{self._title} {reason}")

    def stopped(self) -> None:
        """Print that the node was shut down, and a plate is at 0 V."""
        self._write(f"{self._title} {self._shut_down}")

    def lost(self, reason: BusError) -> None:
        """Print that the bus has failed, and why."""
        self._write(f"{self._title} lost {self._where}, at 0 V: {reason}")

    def back(self) -> None:
        """Print that the bus is available again."""
        self._write(f"{self._title} back on {self._where}")

    def full(self, reason: QueueFullError) -> None:
        """Print that the transmit queue of the bus has no room for a frame of the loop."""
        self._write(f"{self._title} {reason}")

    @property
    def _title(self) -> str:
        node_id = self._device.node_id
        return f"{self._name} {'without node-ID' if node_id == cia.UNCONFIGURED else node_id}"

    @property
    def _double(self) -> str:
        if not self._collision:
            return "alone again with its identifiers"
        cure = (
            ": one producer of SYNC is enough" if self._collision == self._device.ids.sync else ""
        )
        return f"another node sends with an identifier of this one, {self._collision:03X}h{cure}"

    @property
    def _reason(self) -> str:
        """Return why stimulator or front end do not drive; empty if they can."""
        if self._plate is not None:
            trouble = self._plate.backend.trouble
            return f"front end: {trouble}" if trouble else ""
        if self._diagnosis is None:
            return ""
        message, first, latched = self._diagnosis
        if not message.value:
            return ""
        code, text = first.value, message.value
        if latched.value & _DOUBLE:
            # It may be detected after the faults that it has caused, and explains them.
            code, text = WATCHDOGS[Watchdog.DOUBLE].code, WATCHDOGS[Watchdog.DOUBLE].text
        return f"fault {code:04X}h: {text}" if code else str(text)

    def _now(self) -> tuple[NMTState, int, str]:
        mode = self._mode.value if self._mode is not None else 0
        return self._device.nmt_state, mode, self._reason


def _diagnosis(od: ObjectDictionary) -> tuple[Entry, Entry, Entry]:
    return od["Message"], od["Diagnosis.Code"], od["Diagnosis.Latched"]


class Pace(NamedTuple):
    """Pace of a node: SYNC or the clock, its priority and its processor."""

    lockstep: bool = False
    priority: int | None = None
    """Priority of SCHED_FIFO, 1..99; None for an ordinary process."""
    cpu: int | None = None

    def begin(self) -> int | None:
        """Set priority and processor, and report on stderr what the system refuses.

        Raises
        ------
        click.BadParameter
            There is no such processor.

        Returns
        -------
        int or None
            Default in ms for the deadlines of a loop over the bus; None for that of the EDS.
        """
        if self.lockstep:
            return SHORT_DEADLINE_MS
        if self.priority is None:
            request_short_slices()
            return None
        try:
            refused = request_real_time(self.priority, self.cpu)
        except ValueError as error:
            raise click.BadParameter(f"--cpu: {error}") from error
        for line in refused or keep_processors_awake():
            click.echo(line, err=True)
        if refused:
            request_short_slices()
            return None
        return SHORT_DEADLINE_MS


lockstep_option = click.option(
    "--lockstep",
    is_flag=True,
    help="Use SYNC as the only clock: each SYNC advances the time by 1 ms.",
)


def pace_options(command: Command) -> Command:
    """Add the options of the pace to a command, which gets ``pace``, a `Pace`."""

    @wraps(command)
    def called(
        *args: Any, lockstep: bool, realtime: int | None, cpu: int | None, **others: Any
    ) -> Any:
        if lockstep and realtime is not None:
            raise click.UsageError(
                "--realtime runs by the clock, --lockstep by SYNC: give only one of them"
            )
        if cpu is not None and realtime is None:
            raise click.UsageError("--cpu needs --realtime PRIORITY")
        return command(*args, pace=Pace(lockstep, realtime, cpu), **others)

    return with_options(
        lockstep_option,
        click.option(
            "--realtime",
            type=WholeRange(1, 99),
            metavar="PRIORITY",
            help="Run at this priority of SCHED_FIFO, 1..99, with the memory locked, processors"
            f" kept awake and deadlines of {SHORT_DEADLINE_MS} ms. Needs CAP_SYS_NICE, or rtprio in"
            " limits.conf.",
        ),
        click.option(
            "--cpu",
            type=WholeRange(min=0),
            metavar="N",
            help="Stay on this processor, with --realtime.",
        ),
    )(called)


def run_in_process(name: str, node: DeviceNode, bus: BusChoice, pace: Pace) -> None:
    """Run a node until a signal, with a line on stdout for each change of its state."""
    with ExitStack() as stack:
        stop = stack.enter_context(stop_on_signals())
        writer = stack.enter_context(LineWriter(_stdout()))
        meanwhile = None
        if not pace.lockstep:
            meanwhile = stack.enter_context(collecting_between_cycles())
        lines = StateLines(name, bus.where, node, writer.write, meanwhile)
        lasting = ReconnectingBus(bus.open, node, lost=lines.lost, back=lines.back)
        run_node(
            node,
            lasting,
            stop,
            lockstep=pace.lockstep,
            observer=lines,
            resting=pace.priority is not None,
        )


def _stdout() -> int:
    """Return the descriptor of stdout, or of the null device without a stdout."""
    try:
        return sys.stdout.fileno()
    except (OSError, AttributeError, ValueError):
        return os.open(os.devnull, os.O_WRONLY)


_MM: Final = 1e-3
_COLUMNS: Final = {
    name: (low / unit, high / unit)
    for (_, low, high), (name, unit) in zip(
        GIVEN_RANGES, {"t_s": 1.0, "x_mm": _MM, "Fn_N": 1.0}.items(), strict=True
    )
}
MAX_FINGER_BYTES: Final = 8 << 20
MAX_FINGER_ROWS: Final = 100_000
"""Most rows of a recording: 100 s at 1 kHz."""


def read_finger(path: Path) -> Trajectory:
    """Read a recorded finger.

    Parameters
    ----------
    path
        CSV with the header ``t_s,x_mm,Fn_N``: time in s, position along the plate in mm from its
        middle, and normal force in N.

    Raises
    ------
    ValueError
        The header, a number or the order is wrong, or there are fewer than 2 rows or more than
        `MAX_FINGER_ROWS`. Except for too few rows, the message names file and line.
    OSError
        It is no regular file, longer than `MAX_FINGER_BYTES`, or cannot be read.
    """
    samples: list[tuple[float, float, float]] = []
    rows = read_numbers(path, _COLUMNS, most_rows=MAX_FINGER_ROWS, most_bytes=MAX_FINGER_BYTES)
    for line, (time, x_mm, Fn) in rows:
        if samples and time <= samples[-1][0]:
            before = samples[-1][0]
            raise ValueError(f"{path}: line {line}: t_s {time:g} is not after {before:g}")
        samples.append((time, x_mm * _MM, max(Fn, 0.0)))
    try:
        return Trajectory(samples)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _finger(
    _ctx: click.Context, _param: click.Parameter, value: str
) -> tuple[int, Trajectory | None]:
    """Return motion and recording for ``none``, ``stroke`` or a file."""
    if value == "none":
        return LIFTED, None
    if value == "stroke":
        return STROKE, None
    with plain_errors(ValueError):
        try:
            return RECORDED, read_finger(Path(value))
        except FileNotFoundError as error:
            text = f"{value!r} is neither none, stroke nor a file: {reason(error)}"
            raise click.BadParameter(text) from error


def node_options(node_id: int) -> Callable[[Command], Command]:
    """Add the options of ``node`` and ``plate`` to a command, with this default node-ID."""
    return with_options(
        bus_options,
        click.option(
            "--node-id",
            type=NODE_ID,
            help=f"Node-ID.  [default: the stored node-ID, or {node_id}]",
        ),
        unconfigured_option,
        pace_options,
        click.option(
            "--finger",
            callback=_finger,
            metavar="none|stroke|FILE",
            default="stroke",
            show_default=True,
            help="Finger of the simulated plate; FILE is CSV with t_s,x_mm,Fn_N.",
        ),
        click.option(
            "--subject",
            type=WholeRange(1, 9),
            default=1,
            show_default=True,
            help="Number of the simulated finger: 1..5 presets, 6..9 fitted to Table I.",
        ),
        seed_option("Seed of sensor noise and finger."),
        click.option(
            "--eds",
            type=click.Path(exists=True, path_type=Path),
            metavar="FILE",
            help="EDS that replaces the packaged one, with other default values.",
        ),
        storage_option(
            "File for the values that 1010h and LSS store; without it they are lost at the end."
            " The stimulator also keeps its newest faults, in FILE.faults."
            " A stored value replaces the default of an option, but not an option that you give."
        ),
    )


@click.command(
    epilog="\b\nExamples:\n  smarttac node --interface socketcan --channel can0\n"
    "  smarttac node --interface socketcan --channel can0 --plate-node 33 --produce-sync"
)
@node_options(STIMULATOR_ID)
@click.option(
    "--plate-node", type=NODE_ID, help="Node-ID of the plate.  [default: simulate it inside]"
)
@click.option(
    "--produce-sync", is_flag=True, help="Send the SYNC, which starts each cycle of the plate."
)
def node(
    *,
    node_id: int | None,
    unconfigured: bool,
    finger: tuple[int, Trajectory | None],
    subject: int,
    seed: int,
    eds: Path | None,
    storage: StorageFile | None,
    plate_node: int | None,
    produce_sync: bool,
    bus: BusChoice,
    pace: Pace,
) -> None:
    """Run the stimulator node until Ctrl-C or SIGTERM; then the plate is at 0 V."""
    if produce_sync and plate_node is None:
        raise click.UsageError("--produce-sync needs --plate-node")
    if produce_sync and pace.lockstep:
        raise click.UsageError("in --lockstep the bench produces SYNC: leave out --produce-sync")
    if plate_node is not None:
        _refuse_finger("for the plate inside: give it to smarttac plate")
    with plain_errors(), blaming(eds):
        od, fixed = load_node("stimulator.eds", eds, node_id, unconfigured, STIMULATOR_ID)
        require_two_nodes(od.node_id, plate_node)
        motion, recording = finger
        inside, presets = None, {}
        if plate_node is None:
            inside = PlateBlock(plate_od(), recording)
            presets = _finger_presets(od, motion, subject, seed)
            know_nulls(od, inside.plate.nulls)
        device = StimulatorNode(
            od,
            inside,
            plate_node_id=plate_node or 0,
            produce_sync=produce_sync,
            lockstep=pace.lockstep,
            deadline_ms=pace.begin(),
            presets=presets,
            storage=storage,
            node_id=fixed,
        )
        with _keeping_faults(device, storage):
            run_in_process("stimulator", device, bus, pace)


@click.command(
    epilog="\b\nExamples:\n  smarttac plate --interface socketcan --channel can0 --node-id 33\n"
    "  smarttac plate --interface socketcan --channel can0 --front-end lab.daq:DaqPlate"
)
@node_options(PLATE_ID)
@click.option(
    "--front-end",
    metavar="NAME",
    help="Front end that connects hardware instead of the simulated plate: a name that its package"
    " registers, or module:Class.",
)
def plate(
    *,
    node_id: int | None,
    unconfigured: bool,
    finger: tuple[int, Trajectory | None],
    subject: int,
    seed: int,
    eds: Path | None,
    storage: StorageFile | None,
    front_end: str | None,
    bus: BusChoice,
    pace: Pace,
) -> None:
    """Run the plate as a node of its own, simulated or real, until Ctrl-C or SIGTERM."""
    with plain_errors(), blaming(eds), ExitStack() as stack:
        od, fixed = load_node("plate.eds", eds, node_id, unconfigured, PLATE_ID)
        motion, recording = finger
        hardware = None
        presets = {}
        if front_end is None:
            presets = _finger_presets(od, motion, subject, seed)
        else:
            _refuse_finger("for the simulated plate: leave it out with --front-end")
            hardware = stack.enter_context(_front_end(front_end, by_clock=not pace.lockstep))
        device = PlateNode(
            od,
            presets,
            recording,
            front_end=hardware,
            session=0 if hardware is None else randbelow(TICK_MASK + 1),
            deadline_ms=pace.begin(),
            storage=storage,
            node_id=fixed,
        )
        run_in_process("plate", device, bus, pace)


@contextmanager
def _front_end(name: str, *, by_clock: bool) -> Iterator[TimedPlate]:
    here = str(Path.cwd())
    sys.path.append(here)
    try:
        with opened_front_end(name, by_clock=by_clock) as plate:
            yield plate
    except FrontEndError as error:
        raise click.ClickException(one_line(error)) from error
    finally:
        sys.path.remove(here)


@contextmanager
def _keeping_faults(device: StimulatorNode, storage: StorageFile | None) -> Iterator[None]:
    """Store the latest faults beside the parameters; a failing file does not stop the node."""
    if storage is None:
        yield
        return
    path = storage.path.with_name(f"{storage.path.name}.faults")
    memory = device.block.supervisor.memory

    def report(error: OSError) -> None:
        warn(path, [f"the newest faults are not kept: {error.strerror or error}"])

    file = StorageFile(path)
    try:
        memory.recall(read_lines(file))
    except OSError as error:
        report(error)
    with FaultFile(file, lambda: memory.lines, report):
        yield


def _refuse_finger(reason: str) -> None:
    """Refuse options of the simulated plate if there is none."""
    for name in ("finger", "subject", "seed"):
        if _given(name):
            raise click.UsageError(f"--{name} is {reason}")


def _given(option: str) -> bool:
    source = click.get_current_context().get_parameter_source(option)
    return source is ParameterSource.COMMANDLINE


def _finger_presets(od: ObjectDictionary, motion: int, subject: int, seed: int) -> dict[str, int]:
    """Return the given options as presets; stored values override the defaults of the others."""
    presets: dict[str, int] = {}
    defaults: dict[str, int] = {}
    for option, name, raw in (
        ("finger", "Finger.Motion", motion),
        ("subject", "Simulation.Subject", subject),
        ("seed", "Simulation.Seed", seed),
    ):
        (presets if _given(option) else defaults)[name] = raw
    for name, raw in defaults.items():
        entry = od[name]
        entry.check(raw)
        entry.default = entry.value = raw
    return presets


_OWN_EDS = "leave --eds out, or begin with what 'smarttac eds show' writes"


def load_node(
    packaged: str, other: Path | None, node_id: int | None, unconfigured: bool, absent: int
) -> tuple[ObjectDictionary, int | None]:
    """Load a packaged EDS, or another one in its place, as `load_own`; print its warnings."""
    od, fixed = load_own(other or packaged_eds(packaged), node_id, unconfigured, absent)
    warn(other or packaged, od.warnings)
    return od, fixed


@contextmanager
def blaming(eds: Path | None) -> Iterator[None]:
    """Convert an error about objects that the EDS lacks to one that names the file."""
    try:
        yield
    except (KeyError, ValueError, Abort) as error:
        if eds is None:
            raise
        reason = error.args[0] if isinstance(error, KeyError) else error
        # Not the cause, which a compiled module does not set.
        if KeyError in (type(error), type(error.__context__)):
            reason = f"{reason}, so it is of another version: {_OWN_EDS}"
        message = one_line(f"{eds} does not suit the device: {reason}")
        raise click.ClickException(message) from error


@click.command(
    epilog="Example: smarttac device --eds some.eds --node-id 5 --interface socketcan "
    "--channel vcan0"
)
@click.option(
    "--eds",
    type=EDS_FILE,
    required=True,
    help="EDS or DCF of the device.",
)
@click.option(
    "--node-id",
    type=NODE_ID,
    help="Node-ID.  [default: that of a DCF, the stored node-ID, or 1]",
)
@unconfigured_option
@bus_options
@click.option("--autostart", is_flag=True, help="Go to OPERATIONAL without a master.")
@lockstep_option
@storage_option("File for stored parameters; without it they are lost at the end.")
@click.option(
    "--answers",
    type=OLD_FILE,
    metavar="FILE",
    help="Python file whose ANSWERS maps objects to functions that compute their values.",
)
def device(
    *,
    eds: Path,
    node_id: int | None,
    unconfigured: bool,
    bus: BusChoice,
    autostart: bool,
    lockstep: bool,
    storage: StorageFile | None,
    answers: Path | None,
) -> None:
    """Run a device of any EDS, with its values in memory, until Ctrl-C or SIGTERM.

    The device has every service whose objects are in the EDS. All other objects only store values:
    the device returns a written value to a later read, and sends it in TPDOs. A PDO is off
    if its mapping or its CAN-ID is not valid. From a DCF the device takes the node-ID, too.
    """
    with plain_errors():
        od, fixed = load_own(eds, node_id, unconfigured)
        warn(eds, [*od.warnings, *map(str, check_pdos(od))])
        if answers is not None:
            _answer(od, answers)
        node = DeviceNode(Device(od, autostart=autostart, storage=storage, node_id=fixed))
        run_in_process("device", node, bus, Pace(lockstep))


def _answer(od: ObjectDictionary, file: Path) -> None:
    """Let objects be computed by the functions of ``ANSWERS`` in a Python file, when read."""
    with naming(file, ValueError):
        found = runpy.run_path(str(file)).get("ANSWERS")
        if not isinstance(found, dict):
            raise ValueError("it has no ANSWERS, a function for each object by its name")
        for name, function in found.items():
            entry = find_entry(od, name)
            if not isinstance(entry.default, int | float) or not callable(function):
                raise ValueError(f"{name} is no number, or its answer no function")
            if entry.writable or entry.index <= cia.COMMUNICATION_LAST:
                raise ValueError(f"{name} is writable, or of CiA 301: answer a read-only object")
            entry.compute(partial(_bounded, entry, function, od))


def _bounded(
    entry: Entry, function: Callable[[ObjectDictionary], float], od: ObjectDictionary
) -> float:
    """Return the answer of a function, rounded to an integer object and within its limits."""
    value = function(od)
    return min(max(value if entry.data_type in REAL else round(value), entry.low), entry.high)
