"""A view as lines of text for a terminal: plain characters, and a style for each line."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from textwrap import wrap
from typing import Final, NamedTuple

from smarttac_can.watch.view import Peer, View

LEAST_COLUMNS: Final = 72
LEAST_LINES: Final = 20
"""Of the view itself."""
_HALF_PLATE_MM: Final = 38.0
_COF_MAX: Final = 1.0
_STEPS: Final = " ▁▂▃▄▅▆▇█"
_NOTHING: Final = "-"
_EDGE: Final = 14
"""Columns that label and value take in front of a bar."""


class Line(NamedTuple):
    """One line of the screen."""

    text: str
    style: str = ""
    """``head``, ``alarm``, ``note``, ``faint``, or empty for an ordinary line."""


def lines(view: View, where: str, width: int, height: int, below: int = 0) -> list[Line]:
    """Lay a view out, at most `height - below` lines of at most `width` columns.

    Parameters
    ----------
    where
        Name of the bus.
    width, height
        Of the whole terminal.
    below
        Lines of it that others need.
    """
    told = (
        f"the terminal has {width} x {height} characters, "
        f"watch needs {LEAST_COLUMNS} x {LEAST_LINES + below}: make it larger"
    )
    height -= below
    if width < LEAST_COLUMNS or height < LEAST_LINES:
        return [Line(text, "alarm") for text in wrap(told, max(width, 1))[: max(height, 0)]]
    laid = [*_top(view, where), *_contact(view, width), *_drive(view), *_counts(view)]
    urgent = [*_urgent(view, width)]
    # What is wrong comes before what was wrong, if there is no room for both.
    room = height - len(laid)
    laid += urgent[:room]
    laid += list(_emergencies(view))[: max(0, room - len(urgent))]
    return [Line(text[:width], style) for text, style in laid]


def _top(view: View, where: str) -> Iterator[Line]:
    load = f"bus load {view.bus_load:.1%}, {view.frame_rate:.0f} frames/s"
    yield Line(f"SMARTTAC on {where}   {load}", "head")
    yield Line("   ".join(_peer(peer) for peer in view.peers))
    style = "alarm" if view.state == "fault" else "head"
    flags = ", ".join(view.flags) or _NOTHING
    state = view.state or _NOTHING
    yield Line(f"state {state:<12} mode {view.mode or _NOTHING:<20} {flags}", style)
    yield Line("")


def _peer(peer: Peer) -> str:
    if peer.silent is None:
        return f"{peer.name} {peer.node_id}: not heard"
    return f"{peer.name} {peer.node_id}: {peer.nmt or 'heard'}"


def _contact(view: View, width: int) -> Iterator[Line]:
    room = width - _EDGE - 2
    yield Line(f"{'COF':<6}{_number(view.cof, 3):>7} {_bar(view.cof, view.cof_reference, room)}")
    reference = _number(view.cof_reference, 3)
    yield Line(f"{'asked':<6}{reference:>7}  0 to {_COF_MAX:g}; | is the reference", "faint")
    yield Line(f"{'course':<14}{_course(view.history, room)}")
    yield Line(f"{'finger':<6}{_number(view.position_mm, 1):>7} {_finger(view, room)}")
    yield Line(
        f"normal {_number(view.normal_n, 3)} N   tangential {_number(view.tangential_n, 3)} N"
    )


def _drive(view: View) -> Iterator[Line]:
    amplitude, voltage = _number(view.amplitude_um, 3), _number(view.voltage_v, 2)
    frequency, warmth = _number(view.frequency_hz, 2), _number(view.temperature_degc, 1)
    yield Line(
        f"amplitude {amplitude} um   voltage {voltage} V   frequency {frequency} Hz   {warmth} degC"
    )
    volts, left, right, boundary = (
        view.read.get(f"Setpoint.{name}")
        for name in ("Voltage", "COF left", "COF right", "Boundary")
    )
    nanometres = view.read.get("Setpoint.Amplitude")
    yield Line(
        f"set to    {_number(_thousandth(nanometres), 3)} um           "
        f"{_number(_thousandth(volts), 2)} V   COF {_number(left, 3)} left, "
        f"{_number(right, 3)} right of {_number(_thousandth(boundary), 1)} mm",
        "faint",
    )


def _counts(view: View) -> Iterator[Line]:
    named = (
        ("lost", "Lost cycles"),
        ("missed", "Missed deadlines"),
        ("foreign", "Foreign ticks"),
        ("corrupt", "Corrupt measurements"),
        ("surplus", "Surplus measurements"),
    )
    counts = "   ".join(
        f"{_number(view.read.get(f'Cycle.{name}'), 0)} {what}" for what, name in named
    )
    rate = _number(view.cycle_rate, 0)
    cycles = _number(view.read.get("Cycle.Cycles"), 0)
    yield Line(f"cycles {cycles} ({rate}/s)   {counts}")


def _urgent(view: View, width: int) -> Iterator[Line]:
    for text in view.latched:
        yield from _wrapped(f"FAULT: {text}", width, "alarm")
    for text in view.notes:
        yield from _wrapped(text, width, "note")


def _emergencies(view: View) -> Iterator[Line]:
    for emergency in view.emergencies:
        yield Line(
            f"{emergency.ago:6.1f} s ago, node {emergency.node_id}: "
            f"EMCY {emergency.code:04X}h {emergency.text}",
            "faint",
        )


def _wrapped(text: str, width: int, style: str) -> Iterable[Line]:
    return (Line(part, style) for part in wrap(text, width))


def _number(value: float | None, decimals: int) -> str:
    return _NOTHING if value is None else f"{value:.{decimals}f}"


def _thousandth(value: float | None) -> float | None:
    return None if value is None else value * 1e-3


def _bar(value: float | None, reference: float | None, width: int) -> str:
    """Draw a value as a bar, and its reference as a mark."""
    cells = ["#" if at < _column(value or 0.0, width) else "." for at in range(width)]
    if reference is not None:
        cells[min(_column(reference, width), width - 1)] = "|"
    return "".join(cells)


def _column(value: float, width: int) -> int:
    return round(min(max(value / _COF_MAX, 0.0), 1.0) * width)


def _course(history: Sequence[tuple[float | None, float | None]], width: int) -> str:
    """Draw the COF over time, as high as the highest of it."""
    values = [cof for cof, _ in history[-width:]]
    highest = max([value for value in values if value is not None], default=0.0)
    if not highest:
        return ""
    last = len(_STEPS) - 1
    return "".join(
        " " if value is None else _STEPS[max(1, round(value / highest * last))] for value in values
    )


def _finger(view: View, width: int) -> str:
    """Draw the plate from above, with the boundary and the finger on it."""
    cells = ["_"] * width
    boundary = _thousandth(view.read.get("Setpoint.Boundary"))
    if boundary is not None:
        cells[_place(boundary, width)] = ":"
    if view.position_mm is not None:
        cells[_place(view.position_mm, width)] = "O"
    return "".join(cells)


def _place(position_mm: float, width: int) -> int:
    share = (position_mm + _HALF_PLATE_MM) / (2.0 * _HALF_PLATE_MM)
    return min(max(round(share * (width - 1)), 0), width - 1)
