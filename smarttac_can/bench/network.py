"""python-canopen's network with taps for frames: on a bus, in this process, or into a log."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Container, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from heapq import heappop, heappush
from itertools import count
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, time
from typing import Any, ClassVar, Final, Self

import can
import canopen

from smarttac_can.bench.link import Hear
from smarttac_can.canopen.bus.local_bus import LocalBus
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.canopen.od import cia
from smarttac_can.host.background import Background
from smarttac_can.host.drivers import opening
from smarttac_can.host.files import reason
from smarttac_can.host.kernel_filter import enlarge_buffer
from smarttac_can.host.python_can import configured, hears_others_of_process, open_bus

_Tap = tuple[Container[int], Hear]
"""Identifiers, and the function that receives frames with one of them."""
ALL: Final = range(cia.CAN_ID_MASK + 1)
"""All identifiers."""
_LOOK_S: Final = 0.02
_SETTLED_S: Final = 1.0
_OUT_OF_ORDER: Final = (
    "this interface does not echo what this process sends: the raw log has it at the time of "
    "sending, which may not be its place on the bus; set receive_own_messages=1 if the interface "
    "has it"
)


class TappedNetwork(canopen.Network):  # type: ignore[misc]  # python-canopen is untyped
    """A network that passes its data frames, sent and received, to its taps.

    Attributes
    ----------
    hears_itself
        Whether its bus echoes sent frames, by an option or the configuration of python-can.
    """

    def __init__(self) -> None:
        super().__init__()
        self._changing = threading.Lock()
        self._taps: tuple[_Tap, ...] = ()
        self._own_taps: tuple[_Tap, ...] = ()
        self._options: Mapping[str, Any] = {}
        self.hears_itself = False

    threaded: ClassVar[bool] = True
    """Whether a thread receives, so that the effects of a sent frame may come at any time."""

    def now(self) -> float:
        """Return the present time in s, on the clock used for frames."""
        return monotonic()

    def connect(self, **options: Any) -> Self:
        """Connect to a bus of python-can with its options."""
        self._options = options
        self.hears_itself = bool(configured(options).get("receive_own_messages"))
        self.bus = open_bus(options)
        super().connect()
        return self

    def second_bus(self) -> can.BusABC:
        """Open the same bus again; the caller closes it.

        Raises
        ------
        BenchError
            If it cannot be opened twice.
        """
        options = {**self._options, "can_filters": None}
        with opening(options.get("interface"), options.get("channel"), BenchError):
            return open_bus(options)

    @contextmanager
    def tapped(self, can_ids: Container[int], hear: Hear, *, own: bool = False) -> Iterator[None]:
        """Pass frames to a function during a block, before their subscribers.

        Parameters
        ----------
        can_ids
            Identifiers of the frames.
        hear
            Function called in the thread that sends or receives. Blocks may end in any order.
        own
            Whether to pass only frames that are sent here.
        """
        tap = (can_ids, hear)
        with self._changing:
            if own:
                self._own_taps += (tap,)
            else:
                self._taps += (tap,)
        try:
            yield
        finally:
            with self._changing:
                self._taps = tuple(other for other in self._taps if other is not tap)
                self._own_taps = tuple(other for other in self._own_taps if other is not tap)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a frame."""
        if not remote:
            _to_taps((*self._taps, *self._own_taps), can_id, bytes(data))
        super().send_message(can_id, data, remote)

    def notify(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Pass on a received frame."""
        _to_taps(self._taps, can_id, bytes(data))
        super().notify(can_id, data, timestamp)


def _to_taps(taps: Iterable[_Tap], can_id: int, data: bytes) -> None:
    for can_ids, hear in taps:
        if can_id in can_ids:
            hear(can_id, data)


class LocalNetwork(TappedNetwork):
    """A network without threads: all effects of a sent frame have happened when `send` returns.

    Parameters
    ----------
    bus
        Bus to connect to.
    """

    threaded = False

    def __init__(self, bus: LocalBus) -> None:
        super().__init__()
        self._local_bus = bus
        self._port = bus.connect(self._on_frame)

    def now(self) -> float:
        """Return the time on the bus in s."""
        return self._local_bus.time * 1e-6

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a frame; all its effects have happened on return."""
        frame = Frame(can_id, bytes(data), remote)
        if not remote:
            _to_taps(self._taps, can_id, frame.data)
        self._port.send(frame)

    def disconnect(self) -> None:
        """Shut the nodes down and leave the bus."""
        self._local_bus.shutdown()
        self._port.close()

    def _on_frame(self, frame: Frame) -> None:
        can_id, data, rtr = frame
        if not rtr:
            _to_taps(self._taps, can_id, data)
            for callback in self.subscribers.get(can_id, ()):
                callback(can_id, bytearray(data), self._local_bus.time * 1e-6)


@contextmanager
def raw_log(network: TappedNetwork, path: Path) -> Iterator[str]:
    """Log all frames of a bus during a block, including those that the network sends.

    If the interface lets a second handle receive what this process sends, such a handle logs the
    frames, so that all have the order and the times of the bus.

    Parameters
    ----------
    network
        Network that is connected, or on a local bus.
    path
        File to create; it must not exist. Its suffix selects the format: ASC, BLF, CSV, candump
        (``.log``), SQLite, TRC and so on.

    Yields
    ------
    str
        One line on how the log differs from the bus; empty if it does not.

    Raises
    ------
    BenchError
        If the file exists or cannot be written, python-can does not have the format, or the bus
        cannot be opened a second time; after the block, if frames could not be received or written.
    """
    note = ""
    with ExitStack() as stack:
        second = None
        if network.threaded and hears_others_of_process(network.bus):
            second = stack.enter_context(network.second_bus())
        file = _File(path)
        stack.callback(file.stop)
        if isinstance(network, LocalNetwork):
            stack.enter_context(_tapping(network, file))
        elif second is not None:
            stack.enter_context(_listening(second, file))
        else:
            stack.enter_context(_beside(network, file))
            note = "" if network.hears_itself else _OUT_OF_ORDER
        yield note
    if file.failures:
        first = file.failures[0]
        raise BenchError(f"{path} cannot be written: {_why(first)}") from first


def require_raw(path: Path) -> None:
    """Refuse a raw log that could not be made; called before a bus is opened.

    Raises
    ------
    BenchError
        If the file exists, its folder does not, or python-can does not have the format.
    """
    if os.path.lexists(path):
        raise BenchError(f"{path} exists: give the raw log another name")
    require_folder(path)
    with TemporaryDirectory() as folder:
        try:
            can.Logger(Path(folder) / path.name).stop()
        except Exception as error:  # formats raise errors of any type
            raise BenchError(f"cannot log to {path}: {_why(error)}") from error


def require_folder(path: Path) -> None:
    """Raise BenchError if the folder of a file does not exist."""
    if not path.absolute().parent.is_dir():
        missing = FileNotFoundError(errno.ENOENT, "", str(path.absolute()))
        raise BenchError(f"{path} cannot be made: {reason(missing)}")


class _File:
    """A file that logs messages from several threads, and keeps the errors of failed writes."""

    def __init__(self, path: Path) -> None:
        self._logger = _open(path)
        # python-can's notifier receives in one thread, and a bench sends in others.
        self._lock = threading.Lock()
        self.failures: list[Exception] = []

    def log(self, message: can.Message) -> None:
        with self._lock:
            # An error raised here would end the receiving thread, or a transfer of the bench.
            if not self.failures:
                try:
                    self._logger.on_message_received(message)
                except Exception as error:  # noqa: BLE001 (formats raise errors of any type)
                    self.failures.append(error)

    def stop(self) -> None:
        with self._lock:
            try:
                self._logger.stop()
            except Exception as error:  # noqa: BLE001 (the buffered rest may not fit on the disk)
                self.failures.append(error)


def _open(path: Path) -> can.Listener:
    try:
        path.open("xb").close()  # python-can follows a link, and overwrites what it leads to
        return can.Logger(path)
    except FileExistsError:
        raise BenchError(f"{path} exists: give the raw log another name") from None
    except Exception as error:  # formats raise errors of any type
        with suppress(OSError):
            if not path.stat().st_size:
                path.unlink()
        raise BenchError(f"cannot log to {path}: {_why(error)}") from error


def _why(error: Exception) -> object:
    return reason(error) if isinstance(error, OSError) else error


@contextmanager
def _tapping(network: LocalNetwork, file: _File) -> Iterator[None]:
    begun = time() - network.now()

    def tap(can_id: int, data: bytes) -> None:
        file.log(can.Message(begun + network.now(), can_id, is_extended_id=False, data=data))

    with network.tapped(ALL, tap):
        yield


@contextmanager
def _listening(bus: can.BusABC, file: _File) -> Iterator[None]:
    """Log the frames that a second handle receives, until those sent before the end of the block.

    Raises
    ------
    BenchError
        After the block, if the handle failed during it.
    """
    end = inf
    broken: list[Exception] = []
    # On a virtual bus the sending thread may be delayed before all have received its frame, so
    # that an answer overtakes it. The time stamps give the right order.
    waiting: list[tuple[float, int, can.Message]] = []

    def stop() -> None:
        nonlocal end
        end = time()

    def log_until(stamp: float) -> None:
        while waiting and waiting[0][0] <= stamp:
            file.log(heappop(waiting)[2])

    def work() -> None:
        try:
            for number in count():
                message = bus.recv(_LOOK_S)
                if message is not None and message.timestamp <= end:
                    heappush(waiting, (message.timestamp, number, message))
                    log_until(message.timestamp - _SETTLED_S)
                elif time() > end:
                    break
        except (can.CanError, OSError) as error:
            broken.append(error)
        log_until(inf)

    enlarge_buffer(bus)
    with Background("raw log", work, stop):
        yield
    if broken:
        raise BenchError(f"the raw log ends where its bus failed: {broken[0]}") from broken[0]


@contextmanager
def _beside(network: TappedNetwork, file: _File) -> Iterator[None]:
    """Log the frames that the network receives and, unless they are echoed, those that it sends."""

    def tap(can_id: int, data: bytes) -> None:
        file.log(can.Message(time(), can_id, is_extended_id=False, is_rx=False, data=data))

    echoed = network.hears_itself
    with nullcontext() if echoed else network.tapped(ALL, tap, own=True):
        network.notifier.add_listener(file.log)
        try:
            yield
        finally:
            network.notifier.remove_listener(file.log)
