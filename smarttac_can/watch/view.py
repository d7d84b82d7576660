"""What there is to see of a stimulator at one instant, in a person's units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Peer(NamedTuple):
    """A node of the instrument, as its heartbeat shows it."""

    node_id: int
    name: str
    nmt: str
    """NMT state; empty as long as nothing says which."""
    silent: float | None
    """Time in s since any frame of it; None if none has come."""


class Emergency(NamedTuple):
    """An emergency message."""

    ago: float
    """Time in s since it came."""
    node_id: int
    code: int
    text: str


class View(NamedTuple):
    """A stimulator and its bus at one instant; what is not known is None, an empty text or absent.

    Lengths are in mm, the amplitude in um peak-to-peak, all else in the unit of its name.
    """

    peers: tuple[Peer, ...]
    notes: tuple[str, ...]
    """What is wrong or missing, a sentence each."""
    state: str
    mode: str
    flags: tuple[str, ...]
    """Bits of the statusword that are set."""
    cof: float | None
    """None while no finger touches, too."""
    cof_reference: float | None
    tangential_n: float | None
    normal_n: float | None
    amplitude_um: float | None
    voltage_v: float | None
    frequency_hz: float | None
    temperature_degc: float | None
    position_mm: float | None
    """Of the finger, from the middle of the plate; None while none touches."""
    read: Mapping[str, float]
    """What SDO has told, by the name of the object, in its displayed unit."""
    cycle_rate: float | None
    """Cycles a second."""
    latched: tuple[str, ...]
    """Texts of the latched faults."""
    emergencies: tuple[Emergency, ...]
    """The newest first."""
    history: tuple[tuple[float | None, float | None], ...]
    """COF and reference at equal intervals, the newest last."""
    bus_load: float
    """Share of the last second in which the bus was busy, with all stuff bits there may be."""
    frame_rate: float
    """Frames in the last second."""
