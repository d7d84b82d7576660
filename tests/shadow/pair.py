"""A node twice: the old implementation and the new one, given the same calls, and compared."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import state_before
import state_now
from frozen import Package

from smarttac_can.device.frame import Frame
from smarttac_can.vocabulary.watchdogs import COUNTED, Watchdog

State = dict[str, Any]
_MOST_SHOWN: Final = 400


class Difference(AssertionError):
    """The two implementations do not do the same.

    Attributes
    ----------
    where
        The node, and what it was given.
    what
        Name of what differs: ``frames``, ``error``, or of `state_before`, ``levels`` and ``od``.
    old, new
        What it is.
    """

    def __init__(self, where: str, what: str, old: object, new: object) -> None:
        super().__init__(f"{where}: {what}\n  old: {_shown(old)}\n  new: {_shown(new)}")
        self.where = where
        self.what = what
        self.old = old
        self.new = new


class BothFailed(Exception):
    """Both implementations raised the same error: no difference, and nothing to go on with."""


class Side(NamedTuple):
    """A node of one implementation."""

    node: Any
    device: Any
    """What has its services of CANopen: the node itself where there is nothing else."""
    state: Callable[[Any], State]
    """Of the node."""
    services: Callable[[Any], State]
    """Of the device."""
    levels: Callable[[], tuple[float, ...]]
    entries: list[Any]
    """Of its object dictionary, but for constants."""

    def values(self) -> list[Any]:
        """Return the values of the entries."""
        return [e.value if e.source is None else e.source() for e in self.entries]


def side(package: Package, node: Any, kind: str) -> Side:
    """Return a node of a package with what is compared of it; the kind is the name of its class."""
    states: Any = state_now if package.name == "smarttac_can" else state_before
    entries = [entry for entry in node.od if entry.access != "const"]
    alone = kind == "Device"
    return Side(
        node,
        node if alone else node.device,
        {
            "StimulatorNode": states.of_stimulator,
            "PlateNode": states.of_plate,
            "Device": states.of_any,
        }[kind],
        states.of_device,
        tuple if alone else node.levels,
        entries,
    )


_HOT: Final = COUNTED.index(Watchdog.TEMPERATURE)
"""Place of the temperature of a measurement among the levels of a stimulator."""


class _Clocks:
    """The clocks of both nodes, for a host that moves them."""

    def __init__(self, old: Any, new: Any) -> None:
        self._old, self._new = old, new

    @property
    def now(self) -> int:
        return int(self._new.now)

    @now.setter
    def now(self, now: int) -> None:
        self._old.now = self._new.now = now


class Pair:
    """One node for a bus, of which there are two.

    Parameters
    ----------
    name
        For messages.
    old, new
        The same node of both implementations.

    Attributes
    ----------
    od
        Object dictionary of the new one, to look names up.
    calls
        How often it was called.
    """

    def __init__(self, name: str, old: Side, new: Side) -> None:
        self.name = name
        self.old, self.new = old, new
        self.od = new.node.od
        self.clock = _Clocks(old.node.clock, new.node.clock)
        self.calls = 0
        self._last: tuple[str, tuple[Any, ...]] = ("nothing", ())
        self._measurement: tuple[int, ...] = ()

    def start(self) -> list[Frame]:
        return self.call("start")

    def receive(self, frame: Frame) -> list[Frame]:
        return self.call("receive", frame)

    def overtaken(self, frame: Frame) -> list[Frame]:
        return self.call("overtaken", frame)

    def advance(self, microseconds: int) -> list[Frame]:
        return self.call("advance", microseconds)

    def segments(self, most: int) -> list[Frame]:
        return self.call("segments", most)

    def overdue(self) -> list[Frame]:
        return self.call("overdue")

    def transmit_failed(self) -> list[Frame]:
        return self.call("transmit_failed")

    def bus_off(self) -> list[Frame]:
        return self.call("bus_off")

    def bus_recovered(self) -> list[Frame]:
        return self.call("bus_recovered")

    def shutdown(self) -> list[Frame]:
        return self.call("shutdown")

    @property
    def ids(self) -> Any:
        """Identifiers of the new one; those of the old one are compared with all else."""
        return self.new.node.ids

    def look(self, *, all_of_it: bool = True) -> None:
        """Compare what both know: the loop and its levels, and all of the device.

        Parameters
        ----------
        all_of_it
            Whether the services of CANopen and the object dictionary are compared, too.

        Raises
        ------
        Difference
            If it is not the same.
        """
        old, new = self.old, self.new
        state, expected = new.state(new.node), old.state(old.node)
        if state != expected:
            self._compare(expected, state)
        comes = self._comes()
        levels, expected_levels = list(new.levels()), list(old.levels())
        if comes and levels:
            levels[_HOT] = expected_levels[_HOT] = 0.0
        if levels != expected_levels:
            self._require("levels", expected_levels, levels)
        if not all_of_it:
            return
        state, expected = new.services(new.device), old.services(old.device)
        if state != expected:
            self._compare(expected, state)
        if new.values() != old.values():
            for before, now in zip(old.entries, new.entries, strict=True):
                if not (comes and now.name.startswith("Plate input.")):
                    self._require(f"od {now.name}", before.read(), now.read())

    def _comes(self) -> bool:
        """Whether since a whole measurement was answered frames of another may have come.

        The old stimulator shows each of them at once, this one all three if they are answered.
        """
        if not getattr(self.new.node, "_plate_node_id", 0):
            return False
        loop = self.new.node._loop
        before, self._measurement = self._measurement, loop.measurement
        return self._measurement is before or bool(loop._pairing._come)

    def _compare(self, expected: State, state: State) -> None:
        for name in sorted({*expected, *state}):
            self._require(name, expected.get(name, "none"), state.get(name, "none"))

    def _require(self, what: str, expected: object, found: object) -> None:
        # What is not equal to itself, as NaN, shows the same.
        if expected != found and repr(expected) != repr(found):
            raise Difference(self._where(), what, expected, found)

    def _where(self) -> str:
        name, arguments = self._last
        return f"{self.name}, after {' '.join([name, *map(shown, arguments)])}"

    def call(self, name: str, *arguments: Any, **options: Any) -> list[Frame]:
        """Call a method of both; what it returns is compared.

        Raises
        ------
        Difference
            If it is not the same, or only one of them fails, or they do so differently.
        BothFailed
            If both fail in the same way.
        """
        self.calls += 1
        self._last = name, arguments
        expected, failed = _called(self.old.node, name, arguments, options)
        found, fails = _called(self.new.node, name, arguments, options)
        if failed != fails:
            raise Difference(self._where(), "error", failed, fails)
        if fails:
            raise BothFailed(f"{self._where()}: {fails}")
        if found != expected:
            raise Difference(
                self._where(),
                "frames",
                [show(frame) for frame in expected],
                [show(frame) for frame in found],
            )
        return found


def _called(
    node: Any, name: str, arguments: tuple[Any, ...], options: dict[str, Any]
) -> tuple[list[Frame], str]:
    """Return what a call of a node returns, or else how it fails."""
    try:
        return getattr(node, name)(*arguments, **options), ""
    except Exception as error:  # noqa: BLE001 - whatever it is, both do the same
        return [], f"{type(error).__name__}: {error}"


def show(frame: Frame) -> str:
    """Return a frame as a transcript has it."""
    return f"{frame[0]:03X} {'rtr' if frame[2] else frame[1].hex(' ').upper()}".rstrip()


def shown(argument: Any) -> str:
    """Return what a call was given."""
    return show(argument) if isinstance(argument, Frame) else str(argument)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _MOST_SHOWN else text[:_MOST_SHOWN] + "..."
