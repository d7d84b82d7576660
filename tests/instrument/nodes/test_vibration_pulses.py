"""A voltage that comes in pulses, under a pick-up that is sound and under one that is not."""

import cmath
import itertools
import math
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from one_watch import Watch

from smarttac_can.vocabulary.signals import Contact
from smarttac_can.vocabulary.watchdogs import Watchdog

OPEN_LOOP, AMPLITUDE_RESONANCE = 1, 3
TAU_MS = 0.944
GAIN_UM = 0.05
LACK = 6
"""Place of the count."""


def missed_after(
    volts: Iterable[float],
    *,
    Fn: float = 0.0,
    load: float = 0.47,
    off_hz: float = 0.0,
    late_ms: float = 0.0,
    scale: float = 1.0,
    direct: float = 1.0,
) -> int:
    """Cycles until the watch misses a vibration of a plate in the frame of its voltage; or 0.

    ``tau W' = -(d + j tau w) W + K V`` is solved exactly; a voltage takes effect late in its cycle.
    """
    damping = 1.0 + load * (Fn / 0.5) ** (2 / 3)
    pole = complex(damping / (TAU_MS * scale), 2e-3 * math.pi * off_hz)
    watch = Watch()
    contact = Contact(0.0, 0.0, Fn, 0.0, 0.0, 0.0, 0.0, touching=Fn > 0.0)
    W, before = 0j, 0.0
    for cycle, V in enumerate(volts, start=1):
        for level, ms in ((before, late_ms), (V, 1.0 - late_ms)):
            settled = GAIN_UM / TAU_MS * level / pole
            W = settled + (W - settled) * cmath.exp(-pole * ms)
        before = V
        watch.drive(V)
        watch.look(complex(direct * W.real, W.imag) * 1e-6, contact, 20.0, OPEN_LOOP)
        if watch.state.counts[LACK] >= 20 * 20:
            return cycle
    return 0


def pulses(high: float, of: tuple[int, int], cycles: int = 2000) -> list[float]:
    """Volts that last for the first of these numbers of cycles, in each of the second."""
    lasting, period = of
    return [high if cycle % period < lasting else 0.0 for cycle in range(cycles)]


@pytest.mark.parametrize(
    ("of", "cycles"),
    # Of a pulse all cycles but the first are judged, and its tail; a pause takes nothing back.
    [((20, 20), 21), ((10, 20), 31), ((4, 20), 85), ((2, 20), 183), ((2, 5), 48), ((2, 200), 1803)],
)
def test_a_weak_pickup_is_found_in_pulses_too(of: tuple[int, int], cycles: int) -> None:
    assert missed_after(pulses(90.0, of), direct=0.1) == cycles


def test_pulses_of_one_cycle_tell_nothing() -> None:
    assert missed_after(pulses(90.0, (1, 2)), direct=0.1) == 0


@given(
    pattern=st.lists(
        st.tuples(st.floats(0.0, 150.0), st.integers(1, 8)), min_size=1, max_size=8
    ).map(lambda steps: [V for V, cycles in steps for _ in range(cycles)]),
    Fn=st.floats(0.0, 1.2),
    load=st.floats(0.47, 1.32),
    off_hz=st.floats(-100.0, 100.0),
    late_ms=st.floats(0.0, 1.0),
    scale=st.floats(0.9, 1.1),
)
def test_no_pulses_make_a_sound_pickup_doubtful(
    pattern: list[float],
    Fn: float,
    load: float,
    off_hz: float,
    late_ms: float,
    scale: float,
) -> None:
    volts = (pattern * 400)[:400]
    found = missed_after(volts, Fn=Fn, load=load, off_hz=off_hz, late_ms=late_ms, scale=scale)
    assert found == 0


@pytest.mark.parametrize(
    ("gain", "Fn", "seen"),
    [(0.4, 0.0, True), (0.4, 0.6, True), (0.4, 0.7, False), (0.3, 1.2, True), (0.5, 0.2, False)],
)
def test_bound_from_below_allows_a_finger_of_most_damping(
    gain: float, Fn: float, seen: bool
) -> None:
    assert (missed_after([90.0] * 100, Fn=Fn, direct=gain) > 0) == seen


def told_after(volts: float, readings: Iterable[complex], mode: int, watchdog: Watchdog) -> int:
    """Cycles until a watch trips on readings of a pick-up in um, in turn for ever; or 0."""
    watch = Watch()
    nobody = Contact(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, touching=False)
    for cycle, W in zip(range(1, 5000), itertools.cycle(readings)):
        watch.drive(volts)
        if watch.look(W * 1e-6, nobody, 20.0, mode) >> watchdog & 1:
            return cycle
    return 0


@pytest.mark.parametrize(("sound", "cycles"), [(0, 100), (1, 103), (5, 111), (20, 163), (48, 0)])
def test_lost_resonance_is_found_despite_cycles_of_right_phase(sound: int, cycles: int) -> None:
    readings = [0.5j] * (50 - sound) + [0.5 + 0j] * sound
    assert told_after(100.0, readings, AMPLITUDE_RESONANCE, Watchdog.RESONANCE) == cycles
    assert told_after(100.0, readings, OPEN_LOOP, Watchdog.RESONANCE) == 0


def test_silent_pickup_from_the_first_cycle_is_a_fault_after_10() -> None:
    assert told_after(100.0, [0j], OPEN_LOOP, Watchdog.PICKUP) == 10


def test_loop_closed_again_has_time_to_find_the_resonance() -> None:
    watch = Watch()
    nobody = Contact(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, touching=False)
    for cycle in range(1000):
        mode = OPEN_LOOP if cycle % 100 == 99 else AMPLITUDE_RESONANCE
        watch.drive(100.0)
        assert not watch.look(0.5e-6j, nobody, 20.0, mode) >> Watchdog.RESONANCE & 1


@pytest.mark.parametrize(("driven", "decaying", "cycles"), [(0.5, 0.2j, 0), (0.5j, 0.2, 199)])
def test_lost_resonance_is_judged_under_a_voltage_only(
    driven: complex, decaying: complex, cycles: int
) -> None:
    """At 0 V the vibration has its own frequency, which on a plate that softens is another one."""
    watch = Watch()
    nobody = Contact(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, touching=False)
    tripped = 0
    for cycle in range(1, 1000):
        volts, W = (0.5, driven) if cycle % 2 else (0.0, decaying)
        watch.drive(volts)
        if watch.look(W * 1e-6, nobody, 20.0, AMPLITUDE_RESONANCE) >> Watchdog.RESONANCE & 1:
            tripped = cycle
            break
    assert tripped == cycles
