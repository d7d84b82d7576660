"""Statistics of synthetic frames."""

import struct
from io import BytesIO

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from smarttac_can.assurance.timing.loop_timing import (
    Delays,
    FrozenStage,
    LoopTiming,
    deadline_ms,
    frozen_stage,
    histogram,
)
from smarttac_can.bench.simulation import plate_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.vocabulary.model import PlateModel

MS = 1e-3
START = 1_700_000_000.0
"""As of the clock that the kernel's time stamps are of."""
MEASURED, DRIVEN = 200e-6, 450e-6


def sync() -> Frame:
    return Frame(0x080)


def measurement(tick: int, plate: int = 33) -> Frame:
    return Frame(0x380 + plate, struct.pack("<hhBHB", 0x1111, 0x2222, tick & 0xFF, 7, 0x33))


def drive(tick: int, plate: int = 33) -> Frame:
    return Frame(0x200 + plate, struct.pack("<HIBB", 0x1111, 0x22222222, tick & 0xFF, 0x33))


class Loop:
    """Frames of a loop, with time stamps in ms."""

    def __init__(self) -> None:
        self.timing = LoopTiming(plate_od())

    def feed(self, ms: float, frame: Frame) -> None:
        self.timing.feed(START + ms * MS, frame)

    def cycle(self, tick: int, at: float | None = None) -> None:
        """The cycle of a tick, with SYNC at so many ms; by default as many as the tick."""
        at = tick if at is None else at
        self.feed(at, sync())
        self.feed(at + MEASURED / MS, measurement(tick))
        self.feed(at + DRIVEN / MS, drive(tick))

    def cycles(self, first: int, end: int) -> None:
        for tick in range(first, end):
            self.cycle(tick)


@pytest.fixture
def loop() -> Loop:
    return Loop()


def test_a_punctual_loop(loop: Loop) -> None:
    loop.cycles(0, 1001)
    timing = loop.timing
    assert (timing.ticks, timing.missed, timing.lost) == (1000, 0, 0)
    assert timing.sync.counts == {0: 1000}
    assert timing.measurement.counts == {200: 1001}
    assert timing.drive.counts == {450: 1001}
    assert timing.gap_s == pytest.approx(MS, abs=1e-6)


def test_the_frames_are_those_of_the_plate_s_node_id() -> None:
    timing = LoopTiming(plate_od(5))
    timing.feed(START, sync())
    for plate in (33, 5):
        timing.feed(START + MEASURED, measurement(0, plate))
        timing.feed(START + DRIVEN * plate, drive(0, plate))
    assert timing.drive.counts == {round(DRIVEN * 5e6): 1}


def test_frames_without_their_tick_and_remote_ones_are_ignored(loop: Loop) -> None:
    loop.feed(0, sync())
    for frame in (measurement(0), drive(0)):
        loop.feed(0.1, Frame(frame.can_id, frame.data[:4]))
        loop.feed(0.1, Frame(frame.can_id, b"", rtr=True))
    loop.feed(0.1, Frame(0x080, rtr=True))
    assert not loop.timing.measurement.counts
    assert not loop.timing.drive.counts
    assert not loop.timing.sync.counts


def test_loop_timing_ignores_frames_before_the_first_sync(loop: Loop) -> None:
    loop.feed(-0.5, measurement(255))
    loop.feed(-0.4, drive(255))
    loop.cycles(0, 11)
    assert (loop.timing.ticks, loop.timing.missed, loop.timing.lost) == (10, 0, 0)
    assert loop.timing.drive.counts == {450: 11}


def test_a_late_sync_and_the_one_after_it(loop: Loop) -> None:
    loop.cycles(0, 10)
    loop.cycle(10, at=10.3)
    loop.cycles(11, 21)
    assert (loop.timing.ticks, loop.timing.missed) == (20, 0)
    assert loop.timing.sync.counts == {0: 19, 300: 1}
    assert loop.timing.gap_s == pytest.approx(1.3 * MS, abs=1e-6)


@pytest.mark.parametrize("late", [0.0, 0.4, 0.9])
def test_ticks_without_a_sync(late: float, loop: Loop) -> None:
    """The plate's tick counts go on without a gap: nobody has heard more."""
    loop.cycles(0, 10)
    loop.cycle(10, at=14 + late)
    for n in range(15, 21):
        loop.cycle(n - 4, at=n)
    timing = loop.timing
    assert (timing.ticks, timing.missed, timing.lost) == (20, 4, 0)
    assert timing.sync.quantile_us(1.0) == pytest.approx(4000 + 1000 * late, abs=1)
    assert timing.gap_s == pytest.approx((5 + late) * MS, abs=1e-6)


def test_a_late_drive_has_missed_its_tick_and_keeps_its_delay(loop: Loop) -> None:
    loop.cycles(0, 10)
    loop.feed(10, sync())
    loop.feed(10.2, measurement(10))
    loop.feed(11, sync())
    loop.feed(11.1, measurement(11))
    loop.feed(11.2, drive(10))
    loop.feed(11.4, drive(11))
    loop.cycles(12, 21)
    timing = loop.timing
    assert (timing.ticks, timing.missed) == (20, 1)
    assert timing.drive.counts == {400: 1, 450: 19, 1200: 1}


def test_a_late_measurement_is_that_of_its_own_sync(loop: Loop) -> None:
    loop.cycles(0, 10)
    for n in (10, 11, 12):
        loop.feed(n, sync())
    for n in (10, 11, 12):
        loop.feed(12.5 + (n - 10) * 0.1, measurement(n))
        loop.feed(12.55 + (n - 10) * 0.1, drive(n))
    loop.cycles(13, 21)
    timing = loop.timing
    assert (timing.ticks, timing.missed, timing.lost) == (20, 2, 0)
    assert timing.measurement.counts == {200: 18, 2500: 1, 1600: 1, 700: 1}


def test_a_measurement_without_a_drive(loop: Loop) -> None:
    loop.cycles(0, 10)
    loop.feed(10, sync())
    loop.feed(10.2, measurement(10))
    loop.cycles(11, 21)
    assert (loop.timing.ticks, loop.timing.missed, loop.timing.lost) == (20, 1, 0)
    assert loop.timing.drive.counts == {450: 20}


def test_drives_that_stay_away(loop: Loop) -> None:
    loop.cycles(0, 10)
    for n in range(10, 31):
        loop.feed(n, sync())
        loop.feed(n + 0.2, measurement(n))
    assert (loop.timing.ticks, loop.timing.missed, loop.timing.lost) == (30, 20, 0)
    assert loop.timing.gap_s == pytest.approx((21 - 0.45) * MS, abs=1e-6)


def test_a_drive_answers_no_measurement_of_256_ticks_ago(loop: Loop) -> None:
    loop.cycles(0, 40)
    loop.feed(40, sync())
    loop.feed(40.2, measurement(40))
    loop.cycles(41, 296)
    loop.feed(296, sync())
    loop.feed(296.4, drive(40))
    loop.cycles(297, 400)
    assert max(loop.timing.drive.counts) == 450
    assert loop.timing.gap_s == pytest.approx(2 * MS, abs=1e-6)


def test_a_drive_that_is_sent_again_counts_once(loop: Loop) -> None:
    loop.cycles(0, 11)
    loop.feed(10.8, drive(10))
    loop.cycle(11)
    assert loop.timing.drive.counts == {450: 12}
    assert loop.timing.gap_s == pytest.approx(MS, abs=1e-6)


@pytest.mark.parametrize("lost", [1, 5, 200, 700])
def test_cycles_that_were_not_heard_are_not_missed(lost: int, loop: Loop) -> None:
    loop.cycles(0, 10)
    loop.cycles(10 + lost, 16 + lost)
    timing = loop.timing
    assert (timing.ticks, timing.missed, timing.lost) == (15, 0, lost)
    assert timing.sync.quantile_us(1.0) == 0
    assert timing.measurement.counts == {200: 16}
    assert timing.gap_s == pytest.approx(MS, abs=1e-6)


def test_a_sync_that_was_not_heard(loop: Loop) -> None:
    loop.cycles(0, 10)
    loop.feed(10.2, measurement(10))
    loop.feed(10.45, drive(10))
    loop.cycles(11, 21)
    timing = loop.timing
    assert (timing.ticks, timing.missed, timing.lost) == (19, 0, 1)
    assert timing.sync.quantile_us(1.0) == 0
    assert timing.gap_s == pytest.approx(MS, abs=1e-6)


def test_measurements_that_were_not_heard(loop: Loop) -> None:
    loop.cycles(0, 10)
    for n in (10, 11):
        loop.feed(n, sync())
        loop.feed(n + 0.45, drive(n))
    loop.cycles(12, 21)
    timing = loop.timing
    assert (timing.ticks, timing.missed, timing.lost) == (18, 0, 2)
    assert timing.measurement.counts == {200: 19}


def test_ticks_that_a_late_plate_passes_over_are_missed(loop: Loop) -> None:
    loop.cycles(0, 10)
    for n in range(10, 24):
        loop.feed(n, sync())
    loop.cycle(24)
    loop.cycles(25, 31)
    timing = loop.timing
    assert (timing.ticks, timing.missed, timing.lost) == (30, 14, 0)
    assert timing.gap_s == pytest.approx(15 * MS, abs=1e-6)
    assert timing.measurement.counts == {200: 17}


def test_loop_timing_recovers_from_a_sync_lost_by_the_plate(loop: Loop) -> None:
    loop.cycles(0, 10)
    loop.feed(10, sync())
    for n in range(11, 111):
        loop.cycle(n - 1, at=n)
    timing = loop.timing
    assert timing.measurement.counts == {200: 60, 1200: 50}
    assert (timing.ticks, timing.missed, timing.lost) == (110, 51, 0)


def test_a_run_that_starts_anew_loses_nothing(loop: Loop) -> None:
    loop.cycles(0, 100)
    for n in range(100, 121):
        loop.cycle(n - 100, at=n)
    timing = loop.timing
    assert (timing.ticks, timing.missed, timing.lost) == (120, 0, 0)
    assert timing.drive.counts == {450: 121}


def test_a_sync_that_comes_after_a_late_one_makes_up_for_no_tick(loop: Loop) -> None:
    """Five ticks late, the producer sends two SYNCs in a row and is on time again."""
    loop.cycles(0, 10)
    for at, tick in ((15.1, 10), (15.5, 11), (16.0, 12), (17.0, 13)):
        loop.feed(at, sync())
        loop.feed(at + 0.2, measurement(tick))
        loop.feed(at + 0.3, drive(tick))
    assert (loop.timing.ticks, loop.timing.missed, loop.timing.lost) == (17, 4, 0)


def test_a_plate_that_says_nothing_takes_no_memory(loop: Loop) -> None:
    for n in range(10_000):
        loop.feed(n, sync())
    assert (loop.timing.ticks, loop.timing.missed) == (9999, 9999)
    assert len(loop.timing._unmeasured) <= 100
    assert not loop.timing.ran


def test_quantiles_are_delays_that_came() -> None:
    delays = Delays()
    for us in range(1, 1001):
        delays.add(us * 1e-6)
    assert delays.as_json() == {"p50_us": 500, "p99_us": 990, "p999_us": 999, "max_us": 1000}
    with pytest.raises(ValueError, match="no delays"):
        Delays().quantile_us(0.5)


@pytest.mark.parametrize(
    ("gap", "deadline"),
    [
        (1.0, 3), (1.5, 3), (1.51, 4), (4.2, 9), (50.0, 100), (50.01, None), (900.0, None)
    ],
)  # fmt: skip
def test_the_deadline_is_twice_the_longest_gap(gap: float, deadline: int | None) -> None:
    assert deadline_ms(gap * MS) == deadline


def test_the_keys_of_the_json(loop: Loop) -> None:
    loop.cycles(0, 11)
    figures = loop.timing.as_json()
    assert list(figures) == [
        *("sync", "measurement", "drive", "ticks", "missed", "lost", "gap_max_us"),
        *("deadline_ms", "stage"),
    ]
    assert figures["drive"] == dict.fromkeys(("p50_us", "p99_us", "p999_us", "max_us"), 450)
    assert figures["deadline_ms"] == 3
    assert figures["stage"]["dose_ratio"] == 1.0
    assert figures["gap_max_us"] == 1000


def test_without_a_deadline_there_is_no_stage(loop: Loop) -> None:
    loop.cycles(0, 10)
    loop.cycle(10, at=110)
    figures = loop.timing.as_json()
    assert figures["deadline_ms"] is None
    assert figures["stage"] is None


def test_the_session_of_the_plate_is_taken_off_its_last_tick() -> None:
    loop = Loop()
    for tick in range(300):
        loop.feed(tick, sync())
        loop.feed(tick + 0.1, Frame(0x1A1, struct.pack("<hhBBh", 0, 0, tick & 0xFF, 0, 0)))
        loop.feed(tick + 0.2, measurement(tick + 200))
        loop.feed(tick + 0.4, drive(tick))
    assert loop.timing.drive.counts == {400: 300}


# Closed forms beside numeric integration.


def integrated(deadline_ms: float, tau_ms: float, start: float) -> tuple[float, float, float]:
    """Share reached, time until below 5 %, and dose in ms, by integration."""

    def part(duration: float, final: float, W: float, dose: float) -> tuple[np.ndarray, ...]:
        times = np.linspace(0.0, duration, 20_001)
        solution = solve_ivp(
            lambda _, y: [(final - y[0]) / tau_ms, y[0] ** 2],
            (0.0, duration),
            [W, dose],
            t_eval=times,
            rtol=1e-10,
            atol=1e-12,
        )
        return times, *solution.y

    _, rising, dose = part(deadline_ms, 1.0, start, 0.0)
    times, falling, doses = part(30.0 * tau_ms, 0.0, rising[-1], dose[-1])
    return rising[-1], deadline_ms + times[np.argmax(falling < 0.05)], doses[-1]


@pytest.mark.parametrize("deadline", [0.5, 3.0, 10.0, 20.0])
@pytest.mark.parametrize("tau", [0.944, 3.0])
def test_the_closed_forms(deadline: float, tau: float) -> None:
    stage = FrozenStage(deadline, tau, 150.0, 7.5)
    reached, quiet, dose = integrated(deadline, tau, 0.0)
    assert stage.reached == pytest.approx(reached, abs=1e-6)
    assert stage.quiet_ms == pytest.approx(quiet, abs=30.0 * tau / 20_000)
    assert stage.dose_from_rest == pytest.approx(dose, rel=1e-6)
    assert stage.dose_from_final == pytest.approx(integrated(deadline, tau, 1.0)[2], rel=1e-6)


def test_the_default_limits() -> None:
    shortest = frozen_stage(3).as_json()
    assert shortest == {
        "voltage_v": 150.0,
        "final_um": 7.5,
        "reached_share": 0.9583,
        "below_5_percent_ms": 5.79,
        "dose_ratio": 1.0,
        "dose_ratio_from_rest": 1.0,
    }
    assert frozen_stage(3).tau_ms == pytest.approx(PlateModel().tau * 1e3, rel=1e-3)


@pytest.fixture
def timing() -> LoopTiming:
    timing = LoopTiming(plate_od())
    for second in (0.0, 1.001):
        timing.feed(second, Frame(0x80))
    for delays, late in ((timing.sync, 0), (timing.measurement, 200), (timing.drive, 450)):
        for n in range(1000):
            delays.add((late + n % 50) * 1e-6)
    timing.drive.add(4e-3)
    return timing


def test_every_delay_is_in_the_histogram(timing: LoopTiming) -> None:
    figure = histogram(timing)
    figure.savefig(BytesIO(), format="png", dpi=50)
    (axes,) = figure.axes
    assert axes.get_xlabel() == "delay (ms)"
    assert axes.get_yscale() == "log"
    assert axes.get_title(loc="left") == "Delays in 1001 ticks of the loop, 1001 missed"
    curves = {patch.get_label(): patch.get_data() for patch in axes.patches}
    assert [sum(data.values) for data in curves.values()] == [1000, 1000, 1001]
    assert "drive after SYNC, at most 4.00 ms" in curves
    drives = curves["drive after SYNC, at most 4.00 ms"]
    assert drives.edges[0] == 0
    assert 4.0 < drives.edges[-1] < 4.1
    assert drives.values[-1] == 1
    assert len({patch.get_linestyle() for patch in axes.patches}) == 3
