"""A soak: hours of simulated time with random runs and faults, in which every check must hold."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from enum import IntEnum
from itertools import chain, pairwise
from pathlib import Path
from time import perf_counter
from typing import Any, Final, NamedTuple
from zlib import crc32

from smarttac_can.assurance.trials.fault_cases import CASES, DRIVING, TOLERATED, TRACKED, FaultCase
from smarttac_can.assurance.trials.healthy_runs import TappingFinger
from smarttac_can.assurance.trials.invariants import MOST_VIOLATIONS, Invariants, TripCause
from smarttac_can.assurance.trials.rig import PLATE_LOST_MS, MasterTraffic, Rig
from smarttac_can.assurance.trials.workers import in_order
from smarttac_can.canopen.master.errors import HeartbeatLostError
from smarttac_can.canopen.od.cia import Abort, NMTCommand
from smarttac_can.science.plant.finger import Finger, FingerState, Lifted
from smarttac_can.vocabulary.meanings import LIFTED, RECORDED, STROKE
from smarttac_can.vocabulary.states import Law, Mode, State, VibrationLaw
from smarttac_can.vocabulary.watchdogs import (
    COUNTED,
    FORGOTTEN,
    PLATE_COUNTED,
    RESONANCE_CYCLES,
    Watchdog,
)

# Level of every watchdog while nothing is faulty.


Table = dict[str, dict[str, float]]
"""Largest levels by watchdog and mode; 1.0 is a fault, or 0 V at the plate."""

WHAT: Final = {
    "nmt": "event",
    "heartbeat": "silence, of the consumer time",
    "measurement": "time without one, of the deadline",
    "setpoint": "time without one, of the deadline; none is set in a soak",
    "sync_lost": "time without one, of the deadline",
    "sync_irregular": "too many or too few in a window, of what is a fault",
    "sync_counter": "event",
    "bus_off": "event",
    "transmit_queue": "event",
    "voltage": "drive, of the limit, to which the controllers keep",
    "amplitude": "cycles above the limit, of what is a fault",
    "temperature": "degC, of the limit",
    "normal_force": "force, of the limit",
    "lateral_force": "force, of the limit",
    "saturated": "cycles at the end of a range, of what is a fault",
    "stuck": "samples in a row that rest, of what is a fault",
    "gauges": "cycles with a contradiction, of what is a fault",
    "pickup": "cycles with too much, none or too little, of what is a fault",
    "resonance": "cycles off the resonance, of what is a fault",
    "controller": "event",
    "calibration": "event",
    "plate": "event",
    "double": "measurements beyond one a SYNC, of what is a fault; identifiers are events",
    "unseen": "cycles above the limit, of what is a fault",
    "missed_time": "missed ticks of a second, of the limit",
    "stage": "event",
    "not_enabled": "event",
    "plate_deadline": "time without a drive, of the deadline",
    "plate_wrong_checks": "drives with a wrong check, of what inhibits",
    "plate_temperature": "degC, of the limit",
    "plate_voltage": "drive, of the limit",
    "true_amplitude": "vibration of the plate, of the limit of amplitude",
    "bound_by_the_drive": "vibration that the drive may have made, of the limit of unseen",
}
"""Every watchdog, and the meaning of its level. The last two are the quantities behind two
watchdogs that count cycles."""
_LOOKED_AT: Final = (
    *(watchdog.name.lower() for watchdog in COUNTED),
    *(f"plate_{what.replace(' ', '_')}" for what in PLATE_COUNTED),
    "true_amplitude",
    "bound_by_the_drive",
)
_DIGITS: Final = 3


class Margins:
    """The largest levels of the watchdogs of a rig with a plate node, by mode.

    Parameters
    ----------
    rig
        Rig whose nodes are read by function calls, not over the bus.
    """

    def __init__(self, rig: Rig) -> None:
        self._stimulator = rig.stimulator
        self._plate = rig.plate
        self._supervisor = rig.stimulator.block.supervisor
        self._amplitude_trip = rig.od["Limit.Amplitude trip"]
        self._bound_trip = rig.od["Limit.Amplitude by drive"]
        self._mode = rig.od["Mode"]
        self._run: dict[int, tuple[float, ...]] = {}
        self._kept: dict[int, tuple[float, ...]] = {}

    def look(self) -> None:
        """Update the levels after a cycle in which nothing is faulty."""
        trip, most = self._amplitude_trip, self._bound_trip
        levels = (
            *self._stimulator.levels(),
            *self._plate.levels(),
            abs(self._plate.block.plate.W) / (trip.value * trip.si),
            abs(self._supervisor.watch.vibration.most) / (most.value * most.si),
        )
        _raise(self._run, self._mode.value, levels)

    def keep(self) -> None:
        """Keep the levels since the last call of `keep` or `drop`."""
        for mode, levels in self._run.items():
            _raise(self._kept, mode, levels)
        self._run = {}

    def drop(self) -> None:
        """Drop the levels since the last call, as a watchdog has tripped with a cause."""
        self._run = {}

    def table(self) -> Table:
        """Return the levels that were kept."""
        return {
            name: {
                Mode(mode).name.lower(): round(levels[at], _DIGITS)
                for mode, levels in sorted(self._kept.items())
            }
            for at, name in enumerate(_LOOKED_AT)
        }


def _raise(peaks: dict[int, tuple[float, ...]], mode: int, levels: tuple[float, ...]) -> None:
    before = peaks.get(mode)
    peaks[mode] = levels if before is None else tuple(map(max, before, levels))


def largest(tables: Sequence[Table]) -> Table:
    """Return the largest levels of one or more tables."""
    modes = [
        name for mode in Mode if any((name := mode.name.lower()) in t["voltage"] for t in tables)
    ]
    return {
        name: {mode: max(t[name].get(mode, 0.0) for t in tables) for mode in modes}
        for name in _LOOKED_AT
    }


def margin_rows(table: Table) -> Iterator[tuple[str, ...]]:
    """Yield the margins as rows of text, first the head: watchdog, meaning of the level, levels."""
    modes = list(table["voltage"])
    yield ("Watch", "Level", *(mode.replace("_", " ") for mode in modes))
    for name, what in WHAT.items():
        levels = [f"{table[name][mode]:.2f}" if name in table else "" for mode in modes]
        yield (name.replace("_", " "), what, *levels)


# Time for which a rig has driven, by mode and by law.


_BY_AMPLITUDE: Final = frozenset(
    {Mode.FRICTION, Mode.TEXTURE, Mode.AMPLITUDE, Mode.AMPLITUDE_RESONANCE}
)
"""Modes in which a vibration law acts."""
_S_PER_CYCLE: Final = 1e-3


class DrivenTime:
    """Count of the cycles with a voltage.

    Parameters
    ----------
    rig
        Rig whose object dictionary holds the chosen laws.
    """

    def __init__(self, rig: Rig) -> None:
        self._law = rig.od["Friction law"]
        self._vibration_law = rig.od["Controller.Vibration law"]
        self._cycles: Counter[tuple[Mode, int, int]] = Counter()

    def count(self, mode: Mode) -> None:
        """Count a cycle with a voltage in a mode, under the present laws."""
        self._cycles[mode, self._law.value, self._vibration_law.value] += 1

    def by_mode(self) -> dict[str, float]:
        """Return the seconds for every driving mode, by its name."""
        return self._seconds(DRIVING, lambda mode, _law, _vibration: mode)

    def by_friction_law(self) -> dict[str, float]:
        """Return the seconds in mode friction for every friction law, by its name."""
        return self._seconds(Law, lambda mode, law, _: law if mode is Mode.FRICTION else None)

    def by_vibration_law(self) -> dict[str, float]:
        """Return the seconds for every vibration law, by its name, in modes in which it acts."""
        return self._seconds(
            VibrationLaw, lambda mode, _, law: law if mode in _BY_AMPLITUDE else None
        )

    def _seconds(
        self, kinds: Iterable[IntEnum], of: Callable[[Mode, int, int], int | None]
    ) -> dict[str, float]:
        total: Counter[int | None] = Counter()
        for key, cycles in self._cycles.items():
            total[of(*key)] += cycles
        return {kind.name.lower(): round(total[kind] * _S_PER_CYCLE, 3) for kind in kinds}


# Memory of the process during simulated time.


SAMPLE_CYCLES: Final = 60_000
"""Cycles between two samples: a simulated minute."""
RSS_GROWTH_MIB: Final = 8.0
"""Largest growth of the process in MiB after its first two simulated minutes."""
_WARM_UP_SAMPLES: Final = 2
_PAGE: Final = 4096


class ProcessSize:
    """Samples of the resident memory of this process.

    Attributes
    ----------
    mib
        Samples in MiB; empty on a system without /proc.
    """

    def __init__(self) -> None:
        self.mib: list[float] = []

    def sample(self) -> None:
        """Take a sample."""
        try:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        except OSError:
            return
        self.mib.append(round(pages * _PAGE / 2**20, 1))

    def complaint(self) -> str | None:
        """Return a text with the growth of the process if it is too large, else None."""
        sizes = self.mib[_WARM_UP_SAMPLES:]
        if sizes and max(sizes) - sizes[0] > RSS_GROWTH_MIB:
            return f"the process grew from {sizes[0]} to {max(sizes)} MiB"
        return None


@dataclass
class SoakReport:
    """Actions and results of a soak."""

    seed: int
    simulated_s: float = 0.0
    violated: int = 0
    violations: list[str] = field(default_factory=list)
    runs: int = 0
    driving_s: dict[str, float] = field(default_factory=dict)
    friction_law_s: dict[str, float] = field(default_factory=dict)
    """Seconds with a voltage by friction law, in mode friction."""
    vibration_law_s: dict[str, float] = field(default_factory=dict)
    """Seconds with a voltage by vibration law, in the modes in which one acts."""
    faults: dict[str, int] = field(default_factory=dict)
    """Number of injections of each fault, all while driving."""
    latched: int = 0
    """Number of faults that ended in FAULT; the others ended in a restart."""
    tripped: dict[str, int] = field(default_factory=dict)
    """Number of runs that random set-points ended, by the cause in the true vibration."""
    margins: Table = field(default_factory=dict)
    """Largest level of each watchdog while nothing was faulty, by mode; 1.0 is a fault."""
    tolerated: dict[str, int] = field(default_factory=dict)
    emergencies: int = 0
    master_restarts: int = 0
    transfers: int = 0
    """Number of actions of the master in addition to the scenes."""
    rss_mib: list[float] = field(default_factory=list)
    """Memory of the process at simulated minutes in MiB; empty on a system without /proc."""
    fingerprint: str = ""
    """Check sum of the voltage in every cycle; equal for equal seed and time."""
    wall_s: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether no invariant was violated."""
        return self.violated == 0

    @property
    def speed(self) -> float:
        """Simulated time divided by real time."""
        return self.simulated_s / self.wall_s if self.wall_s else 0.0

    def as_json(self) -> dict[str, Any]:
        """Return the report as JSON values."""
        return asdict(self) | {"passed": self.passed, "speed": round(self.speed, 1)}


def merged(reports: Sequence[SoakReport]) -> SoakReport:
    """Return the report of a soak from the reports of its parts, one or more, in their order.

    The report of a single part is returned unchanged. The fingerprint of several parts is the check
    sum of theirs, and the wall time is the sum over all processes.
    """
    if len(reports) == 1:
        return reports[0]
    own: dict[str, Any] = {
        "violations": [
            f"part {n} of seed {r.seed}, {line}"
            for n, r in enumerate(reports, 1)
            for line in r.violations
        ][:MOST_VIOLATIONS],
        "margins": largest([r.margins for r in reports]),
        "rss_mib": [mib for r in reports for mib in r.rss_mib],
        "fingerprint": f"{crc32(' '.join(r.fingerprint for r in reports).encode()):08x}",
    }
    added = {
        field.name: _added([getattr(r, field.name) for r in reports])
        for field in fields(SoakReport)
        if field.name != "seed" and field.name not in own
    }
    return replace(reports[0], **own, **added)


def _added(values: Sequence[Any]) -> Any:
    """Return the sum of numbers, or of the numbers of each name."""
    if isinstance(values[0], dict):
        names = sorted(set(chain.from_iterable(values)))
        return {name: _added([value.get(name, 0) for value in values]) for name in names}
    return round(sum(values), 3)


# Needed in every cycle: module constants, as looking up an enumeration member is much slower.
_RUNNING: Final = State.RUNNING
_FAULT: Final = State.FAULT


class SoakWatch:
    """Check the invariants of a rig, record watchdog levels, and find the cause of a trip.

    Parameters
    ----------
    rig
        Rig with a plate node; it is observed from now on.

    Attributes
    ----------
    invariants
        Invariants of every cycle.
    margins
        Levels of the watchdogs while nothing is faulty.
    mode
        Mode in which the rig is driven.
    sound
        Whether nothing is faulty, or about to become so.
    cause
        Cause of the last trip in the true vibration of the plate; None for no cause.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._machine = rig.stimulator.block.supervisor.machine
        self.invariants = Invariants(rig)
        self.margins = Margins(rig)
        self.mode = Mode.OPEN_LOOP
        self.sound = False
        self.cause: str | None = None
        self._state = State.READY
        self._trip_cause = TripCause(rig)
        self._driven = DrivenTime(rig)
        self._size = ProcessSize()
        self._check_sum = 0
        rig.observe = self._look

    def end_sound(self) -> None:
        """Keep the levels so far, as something is about to be made faulty."""
        self.sound = False
        self.margins.keep()

    def sum_up(self, report: SoakReport) -> None:
        """Write the results into a report."""
        report.driving_s = self._driven.by_mode()
        report.friction_law_s = self._driven.by_friction_law()
        report.vibration_law_s = self._driven.by_vibration_law()
        report.margins = self.margins.table()
        report.rss_mib = self._size.mib
        if (grown := self._size.complaint()) is not None:
            self.invariants.violate(grown)
        report.violations = self.invariants.violations
        report.violated = self.invariants.violated
        report.fingerprint = f"{self._check_sum:08x}"

    def _look(self) -> None:
        self.invariants.check()
        self._trip_cause.look()
        self._look_closer()
        voltage = self._rig.stage.read()
        if voltage:
            self._driven.count(self.mode)
        self._check_sum = crc32(voltage.to_bytes(4, "little"), self._check_sum)
        if self._rig.cycles % SAMPLE_CYCLES == 0:
            self._size.sample()

    def _look_closer(self) -> None:
        """Update the levels while nothing is faulty, or find the cause of a trip."""
        before, self._state = self._state, self._machine.state
        if self._state is _FAULT:
            self.sound = False
            if before is not _FAULT:
                self.cause = self._trip_cause.of(self._rig.od["Diagnosis.Latched"].value)
        elif self.sound and self._state is _RUNNING:
            self.margins.look()


CYCLES_PER_HOUR: Final = 3_600_000
Progress = Callable[[float], None]
"""Function that is called with the fraction that is done, 0..1."""
_READY_CYCLES: Final = 5
_PATIENCE_CYCLES: Final = 2000
_MISSED: Final = 1 << Watchdog.HEARTBEAT
_USED: Final = tuple(
    case for case in CASES
    if not case.plate_inside and case.prepare is None and not case.breaks_controller
)  # fmt: skip


class _Taps:
    """A finger that taps, drawn anew for each run."""

    taps: Finger = Lifted()

    def at(self, time: float) -> FingerState:
        return self.taps.at(time)


class Soak:
    """One soak on the in-process bus, with a plate node.

    Parameters
    ----------
    cycles
        Length in cycles of 1 ms, 1 or more; the last scene may exceed it.
    seed
        Seed of all random draws.
    progress
        Function that is called with the fraction that is done, 0..1.
    """

    def __init__(self, cycles: int, seed: int, progress: Progress = lambda _share: None) -> None:
        if cycles < 1:
            raise ValueError(f"cycles {cycles} is below 1")
        self._length = cycles
        self._progress = progress
        self._random = random.Random(seed)
        self._finger = _Taps()
        self._rig = rig = Rig(seed=seed, finger=self._finger)
        self._traffic = MasterTraffic(rig, seed, commands=False)
        self._watch = SoakWatch(rig)
        self._invariants = self._watch.invariants
        self._report = SoakReport(seed)
        self._faults: Counter[str] = Counter()
        self._tolerated: Counter[str] = Counter()
        self._tripped_by: Counter[str] = Counter()

    def run(self) -> SoakReport:
        """Run the soak and return its report."""
        start = perf_counter()
        rig, report = self._rig, self._report
        rig.start()
        self._invariants.clear_history()
        scenes: tuple[tuple[Callable[[], None], int], ...] = (
            (self._touch, 4),
            (self._fault, 6),
            (self._mishap, 2),
            (self._restart_master, 1),
        )
        acts, weights = zip(*scenes, strict=True)
        while rig.cycles < self._length:
            self._run_scene(self._random.choices(acts, weights)[0])
            self._progress(min(1.0, rig.cycles / self._length))
        report.simulated_s = rig.cycles * 1e-3
        report.faults = dict(sorted(self._faults.items()))
        report.tolerated = dict(sorted(self._tolerated.items()))
        report.tripped = dict(sorted(self._tripped_by.items()))
        self._watch.sum_up(report)
        report.wall_s = round(perf_counter() - start, 2)
        return report

    def _run_scene(self, scene: Callable[[], None]) -> None:
        try:
            self._begin()
            self._watch.sound = True
            scene()
            self._invariants.check_history()
        except (Abort, HeartbeatLostError) as error:
            self._watch.sound = False
            present = self._rig.od["Diagnosis.Present"].value
            self._invariants.violate(
                f"{scene.__name__.strip('_')} in mode {self._watch.mode.name.lower()}, state "
                f"{self._rig.state.name.lower()}, faults {present:06X}h: {error}"
            )
            self._recover()
        self._report.emergencies += len(self._rig.emergencies)
        self._invariants.clear_history()

    def _cycle(self, count: int, *, traffic: float = 0.0) -> None:
        """Run cycles, a fraction of them with traffic of the master."""
        rig, draw = self._rig, self._random.random
        for _ in range(count):
            if traffic and draw() < traffic:
                self._traffic.send()
                self._report.transfers += 1
            rig.cycle()

    def _begin(self) -> None:
        rig, draw = self._rig, self._random
        self._watch.mode = mode = draw.choice(DRIVING)
        rig.write("Simulation.Seed", draw.randrange(2**32))
        rig.write("Finger.Speed", draw.randint(100, 1500))
        rig.write("Finger.Force variation", draw.randint(0, 300))
        self._draw_setpoints()
        rig.write("Controlword", 0)
        self._finger.taps = TappingFinger(draw)
        rig.start_run(
            subject=draw.randint(1, 5),
            force_mN=draw.randint(200, 1200),
            motion=LIFTED if mode is Mode.IDENTIFY else draw.choice((STROKE, STROKE, RECORDED)),
        )
        rig.drive(mode)
        self._report.runs += 1

    def _draw_setpoints(self) -> None:
        rig, draw = self._rig, self._random
        rig.write("Setpoint.Voltage", draw.randint(1000, 5000))
        rig.write("Setpoint.Frequency", 4_339_000 + draw.randint(-5000, 5000))
        rig.write("Setpoint.Amplitude", draw.randint(300, 1800))
        for side in ("left", "right"):
            rig.write(f"Setpoint.COF {side}", draw.randint(2500, 6000))
        rig.write("Friction law", draw.choice(tuple(Law)))
        rig.write("Controller.Vibration law", draw.choice(tuple(VibrationLaw)))

    def _touch(self) -> None:
        for _ in range(self._random.randint(1, 6)):
            self._cycle(self._random.randint(100, 1500), traffic=0.05)
            if self._tripped("set-points"):
                return
            self._draw_setpoints()
        self._watch.end_sound()

    def _tripped(self, what: str) -> bool:
        """Return whether random set-points or a disturbance of the bus ended the run.

        Only too large a true vibration of the plate may do so; anything else is a violation.
        """
        if self._rig.state is not State.FAULT:
            return False
        self._watch.margins.drop()
        if self._watch.cause is None:
            self._expect_no_fault(what)
        else:
            self._tripped_by[self._watch.cause] += 1
            self._recover()
        return True

    def _expect_no_fault(self, what: str) -> None:
        """Record a false trip, and recover."""
        if self._rig.state is State.FAULT:
            message = self._rig.od["Message"].value
            self._invariants.violate(f"{what} in mode {self._watch.mode.name.lower()}: {message}")
            self._recover()

    def _fault(self) -> None:
        case = self._random.choice([case for case in _USED if self._watch.mode in case.modes])
        self._cycle(450 if self._watch.mode is Mode.IDENTIFY else self._random.randint(300, 700))
        self._expect_no_fault("a stroke")
        self._watch.end_sound()
        if not self._rig.stage.read():
            return
        if case.detunes and self._watch.mode not in TRACKED and not self._tune():
            return
        invariants = self._invariants
        invariants.stage_is_broken = case.breaks_stage
        invariants.deaf = case.deaf
        invariants.hidden_cycles = self._bound(case) if case.hides_vibration else 0
        try:
            self._await_fault(case)
        finally:
            self._mend(case)

    def _tune(self) -> bool:
        """Drive at the resonance, as a lost axis is only detected there; return whether it runs."""
        rig = self._rig
        resonance = rig.od["Setpoint.Frequency"].quantise(rig.plate_block.plate.resonance)
        rig.write("Setpoint.Frequency", resonance)
        self._cycle(_READY_CYCLES)
        self._expect_no_fault("the way to the resonance")
        return rig.state is State.RUNNING

    def _await_fault(self, case: FaultCase) -> None:
        rig = self._rig
        case.inject(rig)
        if not self._wait(case):
            # While armed, a write that relaxes a limit again would be refused.
            rig.write("Controlword", 0)
            return
        self._faults[case.name] += 1
        if rig.stage.read():
            self._invariants.violate(f"{case.name}: {rig.stage.si_value:g} V too late")
        self._cycle(self._random.randint(20, 400), traffic=0.2)
        if rig.state is State.FAULT:
            self._report.latched += 1

    def _bound(self, case: FaultCase) -> int:
        """Return the cycles until detection, which a detuned resonance loop may delay."""
        astray = case.detunes and self._watch.mode in TRACKED
        return case.bound + RESONANCE_CYCLES * astray

    def _wait(self, case: FaultCase) -> bool:
        """Run until a fault must have led to 0 V; return whether it could be detected."""
        rig, bound = self._rig, self._bound(case) + 1
        if case.shows is None:
            self._cycle(bound)
            return True
        shown = 0.0
        for _ in range(_PATIENCE_CYCLES):
            if shown >= bound or rig.state is not State.RUNNING:
                return True
            self._cycle(1)
            left = max(0.0, shown - 1 / FORGOTTEN) if case.adds_up else 0.0
            shown = shown + 1.0 if case.shows(rig) else left
        return False

    def _mend(self, case: FaultCase) -> None:
        case.remove(self._rig)
        self._recover()
        invariants = self._invariants
        invariants.stage_is_broken = invariants.deaf = False
        invariants.hidden_cycles = 0
        if not case.cut_off:
            invariants.check_history()
        self._report.emergencies += len(self._rig.emergencies)
        invariants.clear_history()

    def _mishap(self) -> None:
        """Inject a bus fault that must not end a run, and check that it does not."""
        case = self._random.choice(TOLERATED)
        self._tolerated[case.name] += 1
        self._cycle(300)
        self._watch.end_sound()
        case.inject(self._rig)
        self._cycle(self._random.randint(100, 1000))
        case.remove(self._rig)
        self._tripped(case.name)

    def _restart_master(self) -> None:
        rig = self._rig
        self._cycle(self._random.randint(100, 600))
        self._expect_no_fault("a stroke")
        self._watch.end_sound()
        rig.heartbeat, rig.syncs = False, 0
        self._cycle(self._random.randint(100, 2000))
        if rig.stage.read():
            self._invariants.violate("a voltage without a master")
        rig.heartbeat, rig.syncs = True, 1
        rig.nmt(NMTCommand.RESET_NODE)
        rig.start()
        self._report.master_restarts += 1
        self._invariants.clear_history()

    def _recover(self) -> None:
        rig = self._rig
        rig.nmt(NMTCommand.START)
        rig.configure()
        self._cycle(200)
        # A lost node stays lost until its next heartbeat, and has stopped the stimulator.
        for _ in range(PLATE_LOST_MS):
            if not rig.od["Diagnosis.Present"].value & _MISSED:
                break
            self._cycle(1)
        rig.nmt(NMTCommand.START)
        self._cycle(_READY_CYCLES)
        self._lift()
        if rig.state is State.FAULT:
            rig.reset_fault()
        if rig.state is State.FAULT:
            self._invariants.violate("the fault cannot be reset")
            rig.nmt(NMTCommand.RESET_NODE)
            rig.start()
        rig.write("Controlword", 0)

    def _lift(self) -> None:
        """Lift the finger and tare: zeros taken under a finger would prevent the reset."""
        self._rig.start_run(motion=LIFTED)


# A long soak in independent parts, which may run in parallel.


_GOLDEN: Final = 0x9E3779B9
"""Step between the seeds of two parts: 2^32 divided by the golden ratio, so that none repeats."""
_SEEDS: Final = 1 << 32


class Part(NamedTuple):
    """A part of a soak, run as a `Soak` of its own."""

    cycles: int
    seed: int


def parts(cycles: int, seed: int) -> list[Part]:
    """Divide a soak into equal parts of at most an hour; the first has the seed of the whole.

    Parameters
    ----------
    cycles
        Length in cycles of 1 ms, 1 or more.
    seed
        Seed of the whole, 0..2^32 - 1.
    """
    count = max(1, -(-cycles // CYCLES_PER_HOUR))
    ends = [cycles * n // count for n in range(count + 1)]
    return [
        Part(end - begin, (seed + n * _GOLDEN) % _SEEDS)
        for n, (begin, end) in enumerate(pairwise(ends))
    ]


def soak_in_parts(chosen: Sequence[Part], *, jobs: int = 1, progress: Progress) -> SoakReport:
    """Run all parts; the report does not depend on the number of processes.

    Parameters
    ----------
    chosen
        Parts to run, one or more.
    jobs
        Number of processes that share the parts; with 1 only this process works.
    progress
        Function that is called with the fraction that is done, 0..1. With several parts it is
        called after each part.

    Raises
    ------
    ValueError
        A part is shorter than a cycle.
    BrokenProcessPool
        One of the processes was killed.
    """
    if len(chosen) == 1:
        return Soak(*chosen[0], progress).run()
    return merged(list(in_order(_run, chosen, jobs, progress)))


def _run(part: Part) -> SoakReport:
    return Soak(*part).run()
