"""The watchdogs of every cycle, stepped by hand."""

from __future__ import annotations

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.instrument.nodes.bounds import (
    UNDRIVEN,
    cut_and_record,
    response_at,
    with_drive,
)
from smarttac_can.instrument.nodes.parameters import cascade_parameters
from smarttac_can.instrument.nodes.process_image import Measured
from smarttac_can.instrument.nodes.watches import Seen, WatchPlan, at_rest, watch_plan, watch_step
from smarttac_can.vocabulary.signals import Contact, Drive, Measurement
from smarttac_can.vocabulary.states import IdentificationState
from smarttac_can.vocabulary.watchdogs import Watchdog

RESONANCE_HZ = 43_390.0
LIFTED = Contact(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, touching=False)
UNTARED = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Present(set[Watchdog]):
    """Which watchdogs see a fault, by observation."""

    def observe(self, watchdog: Watchdog, comes: bool) -> None:
        (self.add if comes else self.discard)(watchdog)


def plan_of(od: ObjectDictionary, deadline_ms: int = 3) -> WatchPlan:
    return watch_plan(
        cascade_parameters(od),
        lambda name: od[name].si_value,
        identified=od["Model.State"].value == IdentificationState.DONE,
        deadline_ms=deadline_ms,
    )


class Watch:
    """The watchdogs, which are given a measurement and a drive in turn.

    Sensors that a test does not name differ from cycle to cycle, so that none is stuck.
    """

    def __init__(self, od: ObjectDictionary | None = None, deadline_ms: int = 3) -> None:
        self.plan = plan_of(stimulator_od() if od is None else od, deadline_ms)
        self.state = at_rest(self.plan)
        self.in_force = UNDRIVEN
        self._cycle = 0

    def limit_bound(self, um: float) -> None:
        """Let the bound from above reach something else."""
        limit = um * 1e-6
        bound = self.plan.bound._replace(limit=limit, bare_limit=min(3.27e-6, limit))
        self.plan = self.plan._replace(bound=bound)

    def allowed(self, drive: Drive) -> Drive:
        """Return a drive as it is cut."""
        vibration = self.state.vibration
        return cut_and_record(self.plan.bound, vibration, self.in_force, drive, late=False)[1]

    def drive(self, volts: float, hertz: float = RESONANCE_HZ, *, late: bool = False) -> None:
        """Have a drive go out as it is."""
        bound, vibration = self.plan.bound, self.state.vibration
        response = response_at(bound, vibration, hertz, vibration.damping)
        free = response_at(bound, vibration, hertz, 1.0)
        self.in_force = with_drive(self.in_force, Drive(volts, hertz), response, free, late)

    def look(
        self,
        W: complex = 0j,
        contact: Contact = LIFTED,
        temperature: float = 20.0,
        mode: int = 0,
        ticks: int = 1,
        *,
        asked: Drive = Drive(0.0, RESONANCE_HZ),  # noqa: B008 - a tuple
        left_in: int | None = None,
        zero: tuple[float, ...] | None = None,
        gauges: tuple[float, ...] = UNTARED,
        saturation: int = 0,
        counts: tuple[int, ...] | None = None,
        tick: int | None = None,
        serial: int = 1,
    ) -> int:
        """Return the faults of a cycle; with a zero the gauges are tared."""
        self._cycle += 1
        if tick is None:
            tick = self.state.tick + ticks & 0xFF
        measurement = Measurement(W, gauges, temperature, saturation)  # type: ignore[arg-type]
        seen = Seen(
            measured=Measured(measurement, counts or (3 * self._cycle,) * 9, tick, serial),
            mode=mode,
            left_in=mode if left_in is None else left_in,
            asked=asked,
            contact=contact,
            zero=UNTARED if zero is None else zero,  # type: ignore[arg-type]
            tared=zero is not None,
            in_force=self.in_force,
        )
        self.state, faults = watch_step(self.plan, self.state, seen)
        return faults
