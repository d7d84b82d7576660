"""A soak: hours of simulated time in which everything happens, and nothing may go wrong."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable
from time import perf_counter
from typing import Final

from smarttac_can.master.errors import HeartbeatLostError
from smarttac_can.od.cia import Abort, NMTCommand
from smarttac_can.trials.fault_case import DRIVING, TRACKED, FaultCase
from smarttac_can.trials.fault_cases import CASES, TOLERATED
from smarttac_can.trials.master_traffic import MasterTraffic
from smarttac_can.trials.rig import PLATE_LOST_MS, Rig
from smarttac_can.trials.soak_report import SoakReport
from smarttac_can.trials.soak_watch import SoakWatch
from smarttac_can.vocabulary.modes import Law, Mode, VibrationLaw
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import FORGOTTEN, RESONANCE_CYCLES, Watchdog

CYCLES_PER_HOUR: Final = 3_600_000
_READY_CYCLES: Final = 5
_PATIENCE_CYCLES: Final = 2000
_MISSED: Final = 1 << Watchdog.HEARTBEAT
_USED: Final = tuple(
    case for case in CASES
    if not case.plate_inside and case.prepare is None and not case.breaks_controller
)  # fmt: skip


class Soak:
    """One soak on the in-process bus, with a plate node.

    Parameters
    ----------
    cycles
        How long, in cycles of 1 ms, 1 or more; the last scene may take longer.
    seed
        Of everything.
    progress
        Called with the share that is done, 0..1.
    """

    def __init__(
        self, cycles: int, seed: int, progress: Callable[[float], None] | None = None
    ) -> None:
        if cycles < 1:
            raise ValueError(f"cycles {cycles} is below 1")
        self._length = cycles
        self._progress = progress
        self._random = random.Random(seed)
        self._rig = rig = Rig(seed=seed)
        self._traffic = MasterTraffic(rig, seed, commands=False)
        self._watch = SoakWatch(rig)
        self._invariants = self._watch.invariants
        self._report = SoakReport(seed)
        self._faults: Counter[str] = Counter()
        self._tolerated: Counter[str] = Counter()
        self._tripped_by: Counter[str] = Counter()

    def run(self) -> SoakReport:
        """Let it all happen."""
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
            if self._progress is not None:
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
        """Let cycles pass, a share of them with something from the master."""
        rig, draw = self._rig, self._random.random
        for _ in range(count):
            if traffic and draw() < traffic:
                self._traffic.send()
                self._report.transfers += 1
            rig.cycle()

    def _begin(self) -> None:
        """Start a run with another finger, and drive in a random mode."""
        rig, draw = self._rig, self._random
        self._watch.mode = mode = draw.choice(DRIVING)
        rig.write("Simulation.Seed", draw.randrange(2**32))
        rig.write("Finger.Speed", draw.randint(100, 1500))
        rig.write("Finger.Force variation", draw.randint(0, 300))
        self._draw_setpoints()
        rig.write("Controlword", 0)
        rig.start_run(
            subject=draw.randint(1, 5),
            force_mN=draw.randint(200, 1200),
            touch=mode is not Mode.IDENTIFY,
        )
        rig.drive(mode)
        self._report.runs += 1

    def _draw_setpoints(self) -> None:
        """Draw set-points and laws, which may also change while a run drives."""
        rig, draw = self._rig, self._random
        rig.write("Setpoint.Voltage", draw.randint(1000, 5000))
        rig.write("Setpoint.Frequency", 4_339_000 + draw.randint(-5000, 5000))
        rig.write("Setpoint.Amplitude", draw.randint(300, 1800))
        for side in ("left", "right"):
            rig.write(f"Setpoint.COF {side}", draw.randint(2500, 6000))
        rig.write("Friction law", draw.choice(tuple(Law)))
        rig.write("Controller.Vibration law", draw.choice(tuple(VibrationLaw)))

    def _touch(self) -> None:
        """Let a finger stroke under other set-points, while the master asks a lot."""
        for _ in range(self._random.randint(1, 6)):
            self._cycle(self._random.randint(100, 1500), traffic=0.05)
            if self._tripped("set-points"):
                return
            self._draw_setpoints()
        self._watch.end_sound()

    def _tripped(self, what: str) -> bool:
        """Tell whether set-points at random, or a mishap on the bus, ended the run.

        Only too much vibration may do that, and it has to be that of the plate.
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
        """Note a false alarm, and go on."""
        if self._rig.state is State.FAULT:
            message = self._rig.od["Message"].value
            self._invariants.violate(f"{what} in mode {self._watch.mode.name.lower()}: {message}")
            self._recover()

    def _fault(self) -> None:
        """Break something in the middle of a run, see 0 V, and recover."""
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
        """Drive at the resonance, off which no axis is missed; tell whether the run goes on."""
        rig = self._rig
        resonance = rig.od["Setpoint.Frequency"].quantise(rig.plate_block.plate.resonance)
        rig.write("Setpoint.Frequency", resonance)
        self._cycle(_READY_CYCLES)
        self._expect_no_fault("the way to the resonance")
        return rig.state is State.RUNNING

    def _await_fault(self, case: FaultCase) -> None:
        """Inject a fault, expect 0 V, and ask a lot meanwhile."""
        rig = self._rig
        case.inject(rig)
        if not self._wait(case):
            # What makes a limit laxer again is refused while armed.
            rig.write("Controlword", 0)
            return
        self._faults[case.name] += 1
        if rig.stage.read():
            self._invariants.violate(f"{case.name}: {rig.stage.si_value:g} V too late")
        self._cycle(self._random.randint(20, 400), traffic=0.2)
        if rig.state is State.FAULT:
            self._report.latched += 1

    def _bound(self, case: FaultCase) -> int:
        """Return the cycles to the detection: with small set-points a phase may be led astray."""
        astray = case.detunes and self._watch.mode in TRACKED
        return case.bound + RESONANCE_CYCLES * astray

    def _wait(self, case: FaultCase) -> bool:
        """Let a fault have the time that it may take until 0 V; tell whether it could show."""
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
        """Inject a fault of the bus that must not end a run by itself, and see that it does not."""
        case = self._random.choice(TOLERATED)
        self._tolerated[case.name] += 1
        self._cycle(300)
        self._watch.end_sound()
        case.inject(self._rig)
        self._cycle(self._random.randint(100, 1000))
        case.remove(self._rig)
        self._tripped(case.name)

    def _restart_master(self) -> None:
        """Silence the master, expect 0 V, let it come back and reset both nodes."""
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
        """Start what does not run, and reset the fault if there is one."""
        rig = self._rig
        rig.nmt(NMTCommand.START)
        rig.configure()
        self._cycle(200)
        # Who was missed is so until its next heartbeat, and has stopped the stimulator meanwhile.
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
        """Lift the finger and tare: zeros taken under a finger would bar the reset."""
        self._rig.start_run(touch=False)
