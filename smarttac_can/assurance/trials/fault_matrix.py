"""The fault matrix: inject every fault in every driving mode, and count the cycles until 0 V."""

from __future__ import annotations

import errno
import os
import select
import socket
from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Final, Self
from zlib import crc32

from smarttac_can.assurance.trials.fault_cases import CASES, PREDICTED, FaultCase, Row
from smarttac_can.assurance.trials.rig import PLATE_HEARTBEAT_MS, MasterTraffic, Rig
from smarttac_can.assurance.trials.workers import in_order
from smarttac_can.canopen.bus.bus import BusError, LogHook
from smarttac_can.canopen.bus.local_bus import Connection
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master.errors import HeartbeatLostError
from smarttac_can.canopen.od.cia import Abort, NMTCommand
from smarttac_can.host.can_socket import SocketCan
from smarttac_can.host.drivers import opening
from smarttac_can.vocabulary.meanings import LIFTED, STROKE
from smarttac_can.vocabulary.states import Law, Mode, State, VibrationLaw

_GUARD_S = 1.0


class SocketCanWire:
    """Carry the frames of a `LocalBus` over a SocketCAN interface, such as vcan0.

    The kernel delivers each frame to all sockets before the next one is sent, so a run gives the
    same bits as without the interface. The sockets are used directly, as python-can needs six times
    as long for a frame where system calls are slow.

    Parameters
    ----------
    channel
        Name of the interface, which must be up.

    Raises
    ------
    BusError
        On entry, if the interface does not exist. Later, if it does not accept or deliver a frame,
        or delivers a frame of another sender.
    """

    def __init__(self, channel: str) -> None:
        self._channel = channel
        self._codec = SocketCan()
        self._sockets: dict[Connection, socket.socket] = {}
        self._sent = b""
        self._frame = Frame(0)

    def __enter__(self) -> Self:
        self._open().close()
        return self

    def __exit__(self, *_: object) -> None:
        for party in self._sockets.values():
            party.close()
        self._sockets.clear()

    def connect(self, port: Connection) -> None:
        """Open a socket for a connection.

        Raises
        ------
        BusError
            The interface cannot be opened.
        """
        self._sockets[port] = self._open()

    def disconnect(self, port: Connection) -> None:
        """Close the socket of a connection."""
        self._sockets.pop(port).close()

    def put(self, port: Connection, frame: Frame) -> None:
        """Send a frame over the interface.

        Raises
        ------
        BusError
            The interface does not accept it.
        """
        self._sent = self._codec.encode(frame)
        self._frame = frame
        try:
            self._sockets[port].send(self._sent)
        except OSError as error:
            raise BusError(f"cannot send on {self._channel}: {error}") from error

    def get(self, port: Connection) -> Frame:
        """Receive the frame that was sent last.

        Raises
        ------
        BusError
            The frame does not arrive, or another one does.
        """
        party = self._sockets[port]
        try:
            data = party.recv(self._codec.size)
        except BlockingIOError:
            if not select.select([party], [], [], _GUARD_S)[0]:
                raise BusError(f"{self._channel} has lost {self._frame}") from None
            data = party.recv(self._codec.size)
        except OSError as error:
            raise BusError(f"cannot receive on {self._channel}: {error}") from error
        if data != self._sent:
            raise BusError(f"somebody else sends on {self._channel}, too")
        return self._frame

    def _open(self) -> socket.socket:
        with opening("socketcan", self._channel, BusError):
            if not hasattr(socket, "CAN_RAW"):
                raise OSError(errno.EAFNOSUPPORT, os.strerror(errno.EAFNOSUPPORT))
            party = socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            try:
                party.bind((self._channel,))
            except OSError:
                party.close()
                raise
        party.setblocking(False)
        return party


@dataclass(frozen=True, slots=True)
class FaultRow:
    """Result of one fault in one mode."""

    fault: str
    mode: str
    voltage_before_v: float
    """Voltage of the power stage in the cycle before the fault."""
    detection_bound_cycles: int
    cycles_to_zero: int | None
    """Cycles from the fault to 0 V at the power stage; None if 0 V was not reached."""
    emcy_codes: tuple[str, ...]
    """Different codes of the emergency messages of both nodes until 50 cycles after the bound."""
    state_after: str
    """State of the stimulator when the plate is at 0 V."""
    cycles_at_zero: int
    """Cycles at 0 V afterwards, during traffic of the master."""
    held: bool
    """Whether the plate stayed at 0 V for all cycles."""
    recovered: bool
    """Whether the run continued after cause and fault were cleared."""
    injected_at_s: float
    """Time stamp of the fault in the log."""
    reached_um: float
    """Largest vibration of the plate in um, from the fault until 50 cycles after the bound."""

    covered: bool = True
    """Whether software can act; if not, the cycles to 0 V count from where the node resumes."""

    @property
    def emcy_code(self) -> str | None:
        """Code of the first emergency message after the fault; None if there was none."""
        return self.emcy_codes[0] if self.emcy_codes else None

    @property
    def passed(self) -> bool:
        """Whether the fault led to 0 V until the reset, and in time if software can act."""
        return (
            self.voltage_before_v > 0.0
            and self.cycles_to_zero is not None
            and (not self.covered or self.cycles_to_zero <= self.detection_bound_cycles + 1)
            and self.held
            and self.recovered
        )


def rows_as_json(rows: Iterable[FaultRow]) -> list[dict[str, Any]]:
    """Return the rows as JSON values."""
    return [asdict(row) | {"emcy_code": row.emcy_code} for row in rows]


HOLD_CYCLES: Final = 10_000
"""Cycles for which a plate has to stay at 0 V under any traffic of the master."""
_LOGGED_CYCLES: Final = 50
_UM_PER_M: Final = 1e6
_RUN_UP: Final = {Mode.IDENTIFY: 440}
"""Cycles of driving before the fault. An identification is then in its sweep."""
_OTHER_RUN_UP: Final = 500
_LATE: Final = 10
_GO_ON: Final = 300
_SETTLE: Final = 200
_GONE_CYCLES: Final = PLATE_HEARTBEAT_MS + 1
"""Cycles in which the stimulator detects that a cause is gone; the heartbeat takes longest."""
_SETPOINTS: Final = {
    "Setpoint.Voltage": 4000,
    "Setpoint.Frequency": 4_339_000,
    "Setpoint.Amplitude": 1000,
    "Setpoint.COF left": 3500,
    "Setpoint.COF right": 3500,
}
_PREDICTIVE: Final = {
    "Friction law": Law.PREDICTIVE,
    "Controller.Vibration law": VibrationLaw.PREDICTIVE,
}


class _Log:
    """The frames of one row, without the long parts in which nothing new happens."""

    def __init__(self) -> None:
        self.frames: list[tuple[int, Frame]] = []
        self.time = 0
        self.on = False

    def __call__(self, microseconds: int, frame: Frame) -> None:
        self.time = microseconds
        if self.on:
            self.frames.append((microseconds, frame))


class _Peak:
    """The largest true vibration of a rig's plate, which the pick-up may not read."""

    def __init__(self, rig: Rig) -> None:
        self.um = 0.0
        self._block = rig.plate_block
        rig.observe = self._look

    def _look(self) -> None:
        self.um = max(self.um, abs(self._block.plate.W) * _UM_PER_M)


def fault_matrix(
    chosen: Sequence[Row],
    *,
    hold: int = HOLD_CYCLES,
    log: LogHook | None = None,
    jobs: int = 1,
    channel: str | None = None,
) -> Iterator[FaultRow]:
    """Inject each fault in a run of its own, and yield its row; the rows are reproducible.

    Parameters
    ----------
    chosen
        Rows from `cases`.
    hold
        Cycles for which the plate has to stay at 0 V during traffic of the master.
    log
        Function that is called with each frame and its time stamp in us. Frames before the fault
        and in the inner part of the hold are omitted.
    jobs
        Number of processes that share the rows, 1 or more; with 1 only this process works.
    channel
        SocketCAN interface that carries the frames, for 1 job; None to keep them in the process.

    Raises
    ------
    BusError
        The interface cannot be opened, or another sender uses it.
    """
    offset = 0
    for row, frames, end in _results(chosen, hold, jobs, channel):
        if log is not None:
            for time, frame in frames:
                log(offset + time, frame)
        yield replace(row, injected_at_s=round(row.injected_at_s + offset * 1e-6, 6))
        offset += end


_Result = tuple[FaultRow, list[tuple[int, Frame]], int]
"""A row, its frames with their times in us, and the time at its end."""


def _results(chosen: Sequence[Row], hold: int, jobs: int, channel: str | None) -> Iterator[_Result]:
    if jobs == 1:
        return (_row(case, mode, hold, channel) for case, mode in chosen)
    named = [(case.name, case.predictive, mode) for case, mode in chosen]
    return in_order(partial(_row_by_name, hold), named, jobs)


def _row_by_name(hold: int, row: tuple[str, bool, Mode]) -> _Result:
    """Run a row in another process, to which only the names can be sent: acts are closures."""
    name, predictive, mode = row
    return _row(_BY_NAME[name, predictive], mode, hold, None)


def _row(case: FaultCase, mode: Mode, hold: int, channel: str | None) -> _Result:
    with nullcontext() if channel is None else SocketCanWire(channel) as wire:
        return _row_of(case, mode, hold, wire)


def _row_of(case: FaultCase, mode: Mode, hold: int, wire: SocketCanWire | None) -> _Result:
    log = _Log()
    rig = driving_rig(case, mode, log, wire)
    log.on = True
    rig.cycle(_LOGGED_CYCLES)
    before = rig.stage.si_value
    seen = len(rig.emergencies)
    injected = log.time
    reached = _Peak(rig)
    case.inject(rig)
    cycles_to_zero = _cycles_to_zero(rig, case.bound)
    rig.observe = None
    state = rig.state
    codes = tuple(
        dict.fromkeys(f"{emcy.code:04X}h" for emcy in rig.emergencies[seen:] if emcy.code)
    )
    log.on = False
    seed = crc32(f"{case.name}, {case.way(mode)}".encode())
    at_zero = _cycles_at_zero(rig, hold, MasterTraffic(rig, seed, commands=not case.forgets))
    log.on = True
    recovered = _recovers(rig, case, mode)
    row = FaultRow(
        fault=case.name,
        mode=case.way(mode),
        voltage_before_v=round(before, 2),
        detection_bound_cycles=case.bound,
        cycles_to_zero=cycles_to_zero,
        emcy_codes=codes,
        state_after=state.name.lower(),
        cycles_at_zero=at_zero,
        held=at_zero == hold,
        recovered=recovered,
        injected_at_s=injected * 1e-6,
        reached_um=round(reached.um, 2),
        covered=not case.uncovered,
    )
    return row, log.frames, log.time


def driving_rig(
    case: FaultCase, mode: Mode, log: LogHook | None = None, wire: SocketCanWire | None = None
) -> Rig:
    """Return a rig that drives in a mode, just before the fault."""
    rig = Rig(plate_inside=case.plate_inside, log=log, wire=wire)
    rig.start()
    begin_run(rig, case, mode)
    if case.prepare is not None:
        case.prepare(rig)
        rig.cycle(2)
    rig.drive(mode)
    rig.cycle(_RUN_UP.get(mode, _OTHER_RUN_UP))
    return rig


def begin_run(rig: Rig, case: FaultCase, mode: Mode) -> None:
    """Write set-points and laws, and start a run in which the mode may drive."""
    for name, raw in (_SETPOINTS | _PREDICTIVE if case.predictive else _SETPOINTS).items():
        rig.write(name, raw)
    rig.start_run(motion=LIFTED if mode is Mode.IDENTIFY else STROKE)


def _cycles_to_zero(rig: Rig, bound: int) -> int | None:
    """Count the cycles until the stage stays at 0 V; None if it does not.

    A loop may ask for 0 V for a moment, so the last cycle with a voltage counts.
    """
    window = bound + _LOGGED_CYCLES
    last = 0
    for count in range(1, window + 1):
        if rig.stage.read():
            last = count
        rig.cycle()
    return None if last > window - _LATE else last


def _cycles_at_zero(rig: Rig, hold: int, traffic: MasterTraffic) -> int:
    for count in range(hold):
        traffic.send()
        rig.cycle()
        if rig.stage.read():
            return count
    return hold


def _recovers(rig: Rig, case: FaultCase, mode: Mode) -> bool:
    """Return whether the stimulator drives again after removal of the cause and fault reset."""
    case.remove(rig)
    rig.nmt(NMTCommand.START)
    try:
        rig.configure()
        rig.cycle(_SETTLE)
        begin_run(rig, case, mode)
        if rig.state is State.FAULT:
            _await_none_present(rig)
            rig.reset_fault()
        else:
            rig.write("Controlword", 0)
        rig.drive(mode)
    except (Abort, HeartbeatLostError):
        return False
    rig.cycle(_RUN_UP.get(mode, _OTHER_RUN_UP))
    return rig.state is State.RUNNING and rig.stage.read() > 0


def _await_none_present(rig: Rig) -> None:
    """Wait until no fault is present, as a master has to; give up after `_GONE_CYCLES`."""
    for _ in range(_GONE_CYCLES):
        if not rig.read("Diagnosis.Present"):
            return
        rig.cycle()


def tolerated(case: FaultCase, mode: Mode) -> bool:
    """Return whether a run continues under a fault of `TOLERATED`."""
    rig = driving_rig(case, mode)
    case.inject(rig)
    rig.cycle(_GO_ON if mode is not Mode.IDENTIFY else _LOGGED_CYCLES)
    return rig.state is State.RUNNING and rig.stage.read() > 0


def reached_unseen(case: FaultCase, mode: Mode) -> float | None:
    """Return the largest vibration in um under a fault of `NOT_SEEN`; None if the run ends."""
    rig = driving_rig(case, mode)
    case.inject(rig)
    reached = _Peak(rig)
    rig.cycle(_GO_ON)
    return reached.um if rig.state is State.RUNNING else None


_BY_NAME: Final = {(case.name, case.predictive): case for case in (*CASES, *PREDICTED)}
