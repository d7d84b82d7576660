"""The experiments of the paper, as done at the bench."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np

from smarttac_can.bench.simulation import PLATE_ID, plate_od, stimulator_od
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.bench.traces import Trace
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.timing import cycle_seconds, cyclic_frames
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.science.plant.fitted import FITTED
from smarttac_can.science.plant.friction import check_reach
from smarttac_can.science.plant.subjects import SUBJECTS, Subject
from smarttac_can.studies.paper.references import REFERENCES, STEP_UM
from smarttac_can.vocabulary.signals import TARE_SAMPLES, TICK
from smarttac_can.vocabulary.states import Law, Mode, VibrationLaw

WARM: Final = 30.0
"""Temperature in degC at which the plate is identified for the controllers, before Fig. 5."""
COLD: Final = 20.0
"""Temperature in degC of the experiments."""
WARM_RESONANCE: Final = 43250.0
"""Resonance in Hz at 30 degC, at which Fig. 5 starts (paper, section on Fig. 5)."""
COLD_RESONANCE: Final = 43390.0
"""Resonance in Hz at 20 degC."""
AMPLITUDES: Final = (0.0, 0.5, 1.0, 1.5, 2.0)
"""Amplitudes of Fig. 2 in um."""
FIG2_SUBJECTS: Final = range(1, 6)
COF_REFERENCES: Final = dict(enumerate(REFERENCES, 1))
"""References left and right of the boundary for the four subjects of Table I."""
PASSES: Final = 50
"""Passes of the finger per subject in Table I; every other one is an up-step."""

LOADING_SUBJECT: Final = 1
"""Subject that presses on the plate in Fig. 5 under a load: the fingertip with most damping."""
LOAD_MIN, LOAD_MAX = 0.05, 2.0
"""Bounds of the load in N, as for a simulated finger."""

_RESPONSE_S: Final = 0.06
_TARE_S: Final = TARE_SAMPLES * TICK
_FIG2_S: Final = 0.8
_TOUCH_DOWN_S: Final = 0.3
_RESTING_MM_S: Final = 5.0
_TRAVEL_MM: Final = 16.0
_IDENTIFY_S: Final = 0.6
_VARIATION: Final = 0.2
"""Of force and speed from pass to pass."""

SubjectSet = Literal["presets", "fitted"]
"""Set of fingers for Table I."""


class _Finger(NamedTuple):
    tip: Subject
    number: int
    """Number in *Simulation.Subject*."""
    force: float
    """Normal force in N."""
    speed: float
    """Speed in mm/s."""


_FINGERS: Final[dict[SubjectSet, tuple[_Finger, ...]]] = {
    "presets": tuple(_Finger(SUBJECTS[number - 1], number, 0.5, 60.0) for number in COF_REFERENCES),
    "fitted": tuple(
        _Finger(fitted.subject, number, fitted.force, round(fitted.speed * 1e3, 1))
        for number, fitted in enumerate(FITTED, FIG2_SUBJECTS.stop)
    ),
}


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions of the experiments besides the device."""

    seed: int = 1
    """Seed of noise and of the finger's force and speed, 0..2^32 - 1."""
    law: Law = Law.MEASURED
    """Friction law."""
    dead_time: float = 0.0
    """Time in us from the tick until the new drive is in force, 0..999."""
    vibration_law: VibrationLaw = VibrationLaw.PI
    """Law for amplitude and resonance."""
    load: float = 0.0
    """Normal force in N of a finger on the plate in Fig. 5 and 6, 0.05..2, or 0 without a finger.
    With a finger, a step by 50 % follows."""
    subjects: SubjectSet = "presets"
    """Fingers of Fig. 7 and Table I."""


@dataclass(frozen=True, slots=True)
class Experiment:
    """One run at the bench."""

    name: str
    """Name for the progress display."""
    seconds: float
    """Approximate duration in s of simulated time."""
    run: Callable[[Stimulator], list[Trace]]


def experiments(wanted: frozenset[str], conditions: Conditions) -> list[Experiment]:
    """Return the runs for the wanted figures and table.

    Parameters
    ----------
    wanted
        Some of ``fig2 fig3 fig5 fig6 fig7 table1``; Fig. 3 is the law itself and needs no run.
    conditions
        Conditions of all runs.
    """
    runs = [Experiment("identification", _IDENTIFY_S, lambda bench: _identify(bench, conditions))]
    if wanted & {"fig5", "fig6"}:
        runs += _vibration(conditions)
    if "fig2" in wanted:
        runs += _friction_reduction(conditions)
    if wanted & {"fig7", "table1"}:
        runs += _friction_control(conditions)
    return runs if len(runs) > 1 else []


def _identify(bench: Stimulator, conditions: Conditions) -> list[Trace]:
    """Identify the warm plate, which designs the controllers for it, as in the paper."""
    bench.law = conditions.law
    bench.vibration_law = conditions.vibration_law
    bench.set("Controller.Dead time", conditions.dead_time)
    _begin(bench, conditions, WARM)
    bench.frequency = WARM_RESONANCE
    bench.identify()
    return []


def _vibration(conditions: Conditions) -> Iterator[Experiment]:
    """Yield the runs for Fig. 5 and 6: 1 um on the cold plate, starting at the warm resonance.

    With a finger, a step to 1.5 um follows.
    """
    load = conditions.load
    seconds = _TARE_S + _RESPONSE_S + (_TOUCH_DOWN_S + _RESPONSE_S if load else 0.0)
    for label, mode in (
        ("fig5.amplitude_only", Mode.AMPLITUDE),
        ("fig5.amplitude_and_frequency", Mode.AMPLITUDE_RESONANCE),
    ):

        def run(bench: Stimulator, label: str = label, mode: Mode = mode) -> list[Trace]:
            subject = 0
            if load:
                subject = LOADING_SUBJECT
                bench.finger.stroke(subject, force=load, speed=_RESTING_MM_S)
            _begin(bench, conditions, COLD, subject=subject)
            bench.frequency = WARM_RESONANCE
            bench.amplitude = 1.0
            if load:
                bench.run(_TOUCH_DOWN_S)
            bench.mode = mode
            traces = [bench.run(_RESPONSE_S, label, subject)]
            if load:
                bench.amplitude = STEP_UM
                traces.append(bench.run(_RESPONSE_S, label.replace("fig5", "fig5.step"), subject))
            return traces

        yield Experiment(label, seconds, run)


def _friction_reduction(conditions: Conditions) -> Iterator[Experiment]:
    """Yield the runs for Fig. 2: COF of five subjects at five controlled amplitudes."""
    for subject in FIG2_SUBJECTS:
        for amplitude in AMPLITUDES:

            def run(
                bench: Stimulator, subject: int = subject, amplitude: float = amplitude
            ) -> list[Trace]:
                bench.finger.stroke(subject, travel=30.0)
                _begin(bench, conditions, COLD, subject=subject)
                bench.frequency = COLD_RESONANCE
                bench.amplitude = amplitude
                bench.mode = Mode.AMPLITUDE_RESONANCE if amplitude else Mode.OFF
                return [bench.run(_FIG2_S, f"fig2.{amplitude:.1f}", subject)]

            name = f"fig2 subject {subject}, {amplitude:.1f} um"
            yield Experiment(name, _TARE_S + _FIG2_S, run)


def _friction_control(conditions: Conditions) -> Iterator[Experiment]:
    """Yield the runs for Fig. 7 and Table I: the reference switches in the middle of the plate.

    Raises
    ------
    ValueError
        If a finger cannot reach its references.
    """
    fingers = _FINGERS[conditions.subjects]
    ends = (1.0 - _VARIATION, 1.0 + _VARIATION)
    for references, finger in zip(COF_REFERENCES.values(), fingers, strict=True):
        forces = (ends[0] * finger.force, ends[1] * finger.force)
        speeds = (ends[0] * finger.speed * 1e-3, ends[1] * finger.speed * 1e-3)
        check_reach(finger.tip, *references, forces=forces, speeds=speeds, f0=COLD_RESONANCE)
    for (number, references), finger in zip(COF_REFERENCES.items(), fingers, strict=True):
        seconds = _TOUCH_DOWN_S + PASSES * (1.2 * _TRAVEL_MM / finger.speed)

        def run(
            bench: Stimulator,
            number: int = number,
            cof: tuple[float, float] = references,
            finger: _Finger = finger,
            seconds: float = seconds,
        ) -> list[Trace]:
            bench.finger.stroke(
                finger.number,
                force=finger.force,
                speed=finger.speed,
                travel=_TRAVEL_MM,
                force_variation=_VARIATION,
                speed_variation=_VARIATION,
            )
            _begin(bench, conditions, COLD, subject=number)
            bench.frequency = COLD_RESONANCE
            bench.amplitude = 1.0
            bench.boundary = 0.0
            bench.cof = cof
            bench.mode = Mode.FRICTION
            return [bench.run(seconds, "table1", number)]

        yield Experiment(f"table1 subject {number}", _TARE_S + seconds, run)


def _begin(
    bench: Stimulator, conditions: Conditions, temperature: float, *, subject: int = 0
) -> None:
    """Start a run and tare it, because the gauges drift with temperature.

    Without a subject the finger is lifted. Noise and variations differ between subjects.
    """
    if not subject:
        bench.finger.lift()
    (seed,) = np.random.SeedSequence([conditions.seed, subject]).generate_state(1)
    bench.finger.surroundings(
        seed=int(seed), temperature=temperature, drive_instant=conditions.dead_time
    )
    bench.start_run()
    bench.tare()


def loop_dead_time(bit_rate: int) -> float:
    """Return the longest time in us from the plate's tick to the new drive, over the bus.

    It is the sum of the plate's measurement TPDOs and the drive, from the EDS files. The tick is
    the end of SYNC; computing time is not included.

    Parameters
    ----------
    bit_rate
        Bit rate in bit/s, above 0.
    """
    stimulator = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID)
    stimulator.start()
    frames = cyclic_frames([plate_od(), stimulator.od], TICK)
    loop = [frame for frame in frames if frame.period <= TICK and frame.can_id != cia.SYNC_ID]
    return 1e6 * cycle_seconds(loop, bit_rate)
