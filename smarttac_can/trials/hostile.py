"""An attack: a hostile node on the bus of a driven pair, and a master that does its duty."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from time import perf_counter
from typing import Any, Final

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.device.frame import Frame
from smarttac_can.master.errors import HeartbeatLostError
from smarttac_can.od.cia import DEVICE_TYPE, Abort, NMTCommand
from smarttac_can.trials.good_master import GoodMaster
from smarttac_can.trials.hostile_node import HostileNode
from smarttac_can.trials.invariants import Invariants
from smarttac_can.trials.rig import Rig
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import Watchdog, watchdogs_in

VOLTAGE_MAX: Final = 150.0
"""Stage voltage in V that is never passed: the limit, which nobody raises in a run."""
AMPLITUDE_MAX: Final = 7.5e-6
"""Vibration in m peak-to-peak of the bare plate at that voltage: the most of the hazards' table."""
CYCLES_PER_ACTION: Final = 2.0
"""Mean of the cycles from one action to the next."""
ACTIONS_PER_BURST: Final = 12_500
"""Actions for each burst with the pair's own identifiers, which bars both nodes for 3 s."""
BURST_ACTIONS: Final = (1, 200)
RUNNING_MIN: Final = 0.5
"""Share of the cycles that are RUNNING, at least, in an attack of so many actions or more."""
_BACK_CYCLES: Final = 5000
"""Cycles in which the pair drives again after the attack: 3 s without a double, and resets."""
_UM_PER_M: Final = 1e6


@dataclass
class HostileReport:
    """What an attack did, and what did not hold."""

    seed: int
    actions: dict[str, int] = field(default_factory=dict)
    """How many frames of each kind were sent."""
    cycles: int = 0
    running_share: float = 0.0
    """Share of the cycles in RUNNING."""
    running_share_alone: float = 0.0
    """The same without the cycles in which the watchdog DOUBLE bars."""
    driven_share: float = 0.0
    """Share of the cycles with a voltage."""
    faults: dict[str, int] = field(default_factory=dict)
    """How often each watchdog was the first to trip."""
    resets: int = 0
    arms: int = 0
    repairs: int = 0
    """Objects that the master has put right."""
    peak_um: float = 0.0
    """Largest vibration of the plate itself, peak-to-peak, whatever its pick-up reads."""
    peak_v: float = 0.0
    """Largest voltage of the stage."""
    violated: int = 0
    violations: list[str] = field(default_factory=list)
    wall_s: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether everything held."""
        return self.violated == 0

    def as_json(self) -> dict[str, Any]:
        """Return the report as JSON has it."""
        return asdict(self) | {"passed": self.passed}


class Hostile:
    """One attack on the in-process bus.

    Parameters
    ----------
    actions
        Frames of the hostile node, 1 or more.
    seed
        Of everything.
    progress
        Called with the share that is done, 0..1.
    """

    def __init__(
        self, actions: int, seed: int, progress: Callable[[float], None] | None = None
    ) -> None:
        if actions < 1:
            raise ValueError(f"actions {actions} is below 1")
        self._actions = actions
        self._progress = progress
        self._draw = draw = random.Random(seed)
        self._rig = rig = Rig(seed=seed)
        self._report = HostileReport(seed)
        self._invariants = Invariants(rig)
        rig.start()
        self._master = GoodMaster(rig, draw)
        self._node = HostileNode(rig, draw)
        self._sent: Counter[str] = Counter()
        self._faults: Counter[str] = Counter()
        self._running = self._driven = self._barred = 0
        self._latched = False
        self._last = "nothing"

    def run(self) -> HostileReport:
        """Let it all happen."""
        start = perf_counter()
        rig, report = self._rig, self._report
        begin = rig.cycles
        rig.observe = self._observe
        try:
            self._attack()
            report.cycles = rig.cycles - begin
            self._sum_up()
            self._see_what_is_left()
        except Exception as error:  # noqa: BLE001 - whatever it is, a node must not raise it
            self._violate(f"{type(error).__name__}: {error}")
        report.actions = dict(sorted(self._sent.items()))
        report.faults = dict(sorted(self._faults.items()))
        report.resets, report.arms = self._master.resets, self._master.arms
        report.repairs = self._master.repairs
        report.violated = self._invariants.violated
        report.violations = self._invariants.violations
        report.wall_s = round(perf_counter() - start, 2)
        return report

    def _attack(self) -> None:
        rig, draw, total = self._rig, self._draw, self._actions
        bursts = self._bursts()
        rate = 1.0 / CYCLES_PER_ACTION
        for number in range(total):
            kind, frame = self._node.act(own=number in bursts)
            self._sent[kind] += 1
            self._last = f"{kind}, {_text(frame)}"
            while draw.random() >= rate:
                rig.cycle()
                self._master.act()
            rig.cycle()
            self._master.act()
            if self._progress is not None:
                self._progress((number + 1) / total)

    def _bursts(self) -> set[int]:
        """Draw which actions have an identifier of the pair."""
        draw, total = self._draw, self._actions
        count = max(1, total // ACTIONS_PER_BURST)
        starts = [draw.randrange(total) for _ in range(count)]
        return {first + n for first in starts for n in range(draw.randint(*BURST_ACTIONS))}

    def _observe(self) -> None:
        """Check a cycle."""
        rig, report = self._rig, self._report
        self._invariants.check()
        volts = rig.stage.si_value
        W = abs(rig.plate_block.plate.W)
        report.peak_v = max(report.peak_v, volts)
        report.peak_um = max(report.peak_um, W * _UM_PER_M)
        if volts > VOLTAGE_MAX:
            self._violate(f"{volts:g} V at the power stage, more than {VOLTAGE_MAX:g} V")
        if W > AMPLITUDE_MAX:
            self._violate(f"a vibration of {W * _UM_PER_M:.2f} um")
        supervisor = rig.stimulator.block.supervisor
        self._running += supervisor.state is State.RUNNING
        self._driven += volts > 0.0
        self._barred += bool(supervisor.present >> Watchdog.DOUBLE & 1)
        latched = bool(supervisor.latched)
        if latched and not self._latched:
            first = watchdogs_in(supervisor.latched)[0]
            self._faults[first.name] += 1
        self._latched = latched

    def _sum_up(self) -> None:
        report = self._report
        report.running_share = round(self._running / report.cycles, 4)
        alone = report.cycles - self._barred
        report.running_share_alone = round(self._running / max(1, alone), 4)
        # A short attack has its burst all the same, whose 3 s may be most of it.
        if self._actions >= ACTIONS_PER_BURST and report.running_share < RUNNING_MIN:
            self._violate(f"running in {100 * report.running_share:.1f} % of the cycles only")
        report.driven_share = round(self._driven / report.cycles, 4)

    def _see_what_is_left(self) -> None:
        """See that both nodes answer, and can be driven again by their master alone."""
        rig = self._rig
        self._last = "nothing any more"
        rig.nmt(NMTCommand.START)
        self._master.abort_transfers()
        for node_id, od in ((STIMULATOR_ID, rig.od), (PLATE_ID, rig.plate.od)):
            try:
                rig.master.read(node_id, od.entry(DEVICE_TYPE))
            except (Abort, HeartbeatLostError) as error:
                self._violate(f"node {node_id} is not alive: {error}")
                return
        # A limit that was lowered meanwhile, to 0 V perhaps, is put right before the master arms.
        self._master.disarm()
        for _ in range(_BACK_CYCLES):
            rig.cycle()
            self._master.act()
            if rig.state is State.RUNNING and rig.stage.read():
                return
        self._violate(f"in state {rig.state.name.lower()} {_BACK_CYCLES} cycles after the attack")

    def _violate(self, what: str) -> None:
        self._invariants.violate(f"{what}; before it: {self._last}")


def _text(frame: Frame) -> str:
    """Return a frame as candump has it."""
    return f"{frame.can_id:03X}#{'R' if frame.rtr else frame.data.hex().upper()}"
