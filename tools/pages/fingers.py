"""Fit the fingers of `smarttac reproduce table1 --subjects fitted` to Table I, and print them.

tools/pages/make fingers [SUBJECT ...]

Free are four parameters a subject, `FREE`: characteristic amplitude of the friction map, damping
that the finger adds to the mode, pressing force and speed. Two numbers a subject are aimed at: rise
time and overshoot of the mean curve of the up-steps. Friction without vibration is the middle of
the range that the paper gives, at the finger's own force and speed; all else is that of the preset
in its place.

The objective is the sum of two squares: the differences of rise time and overshoot, as means over
`SEEDS`, from the paper's, in units of 0.5 ms and of 5 % of the step. A finger that cannot reach its
references, or chatters, is out. A random walk from `START`, longer after a step that was better and
shorter after one that was not, looks for the least. Nothing depends on anything but the seeds: the
same machine prints the same fingers. They are checked with other seeds, in
tests/studies/paper/test_fitted.py.

It is no user of `smarttac_can.science.population.fit_finger`, which fits forces of a recording: the
paper has rise times and overshoots of its closed loop, and no recordings.

Example: tools/pages/make fingers 2
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from math import exp, inf
from typing import Final, NamedTuple

import numpy as np
from pages import parser_of

from smarttac_can.bench.traces import Trace
from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.tribometer import calibration
from smarttac_can.science.plant.finger import Stroke
from smarttac_can.science.plant.friction import check_reach, sliding_coefficient
from smarttac_can.science.plant.parameters import PlateParameters
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.subjects import SUBJECTS, Subject
from smarttac_can.science.population.steps import UndefinedError, overshoot_percent, rise_time
from smarttac_can.studies.paper.experiments import COF_REFERENCES, COLD_RESONANCE, PASSES
from smarttac_can.studies.paper.metrics import align_at_switch
from smarttac_can.studies.paper.references import OVERSHOOTS_PERCENT, RISE_TIMES_MS
from smarttac_can.vocabulary.signals import TARE_SAMPLES, TICK, Drive, Setpoint
from smarttac_can.vocabulary.states import Mode

SEEDS: Final = range(101, 105)
STEPS: Final = 8
ENOUGH: Final = 0.1
"""Objective at which a walk ends before its last step."""
FREE: Final[Mapping[str, tuple[float, float]]] = {
    "W0": (0.8e-6, 3e-6),
    "load_damping": (5.0, 18.0),
    "force": (0.3, 1.6),
    "speed": (20e-3, 100e-3),
}
"""Free values with their bounds, SI."""
START: Final = {
    1: (1.83e-6, 13.2, 0.55, 75.2e-3),
    2: (2.62e-6, 7.87, 0.489, 35.6e-3),
    3: (1.5e-6, 7.83, 0.944, 74.9e-3),
    4: (1.5e-6, 16.0, 1.2, 24.4e-3),
}
"""Values of `FREE` from which a walk starts: where coarser ones from the presets arrived."""
CHATTER_MAX: Final = 0.02
"""Bound of the standard deviation of mu before a step; the gauges make 0.011 of it at 0.5 N."""
VARIATION: Final = 0.2
"""Of force and speed from pass to pass, as in the experiment."""
TRAVEL: Final = 16e-3
FIRST_STEP: Final = 0.03
PLATE: Final = PlateParameters()
Values = Mapping[str, float]


class Figures(NamedTuple):
    """Results of a finger: rise time in ms, overshoot in % of the step, chatter."""

    rise: float
    overshoot: float
    chatter: float


def finger(number: int, values: Values) -> Subject:
    """Return the fingertip of a subject, 1..4.

    Raises
    ------
    ValueError
        If it cannot reach its references.
    """
    force, speed = values["force"], values["speed"]
    preset = replace(SUBJECTS[number - 1], W0=values["W0"], load_damping=values["load_damping"])
    own = sliding_coefficient(preset, 0.0, speed, force, 0.0, f0=COLD_RESONANCE)
    subject = replace(preset, mu0=preset.mu0 * (0.25 + 0.1 * number) / own)
    forces = ((1.0 - VARIATION) * force, (1.0 + VARIATION) * force)
    speeds = ((1.0 - VARIATION) * speed, (1.0 + VARIATION) * speed)
    check_reach(subject, *COF_REFERENCES[number], forces=forces, speeds=speeds)
    return subject


def table(number: int, values: Values, seed: int) -> Trace:
    """Run Table I for one finger with plate and controllers alone; keep COF and its reference."""
    low, high = COF_REFERENCES[number]
    stroke = Stroke(
        values["force"],
        values["speed"],
        TRAVEL,
        force_variation=VARIATION,
        speed_variation=VARIATION,
        seed=seed,
    )
    plate = Plate(PLATE, finger(number, values), stroke, seed=seed)
    cascade = Cascade(CascadeParameters(lateral=calibration(PLATE.sensors.crosstalk)))
    setpoint = Setpoint(0.0, COLD_RESONANCE, 1e-6, low, high, 0.0)
    drive = Drive(0.0, COLD_RESONANCE)
    rows = []
    for tick in range(round((0.364 + PASSES * 1.2 * TRAVEL / values["speed"]) / TICK)):
        if tick == TARE_SAMPLES:
            cascade.zero = cascade.null()
            cascade.set_mode(Mode.FRICTION)
        new = cascade.update(plate.sample(), setpoint)
        plate.step(drive, new)
        drive = new
        mu, reference = round(1e4 * cascade.contact.mu), round(1e4 * cascade.mu_ref)
        rows.append((tick, mu, reference, 0, 0, 0, 0, 0))
    return Trace.from_rows("table1", number, rows)


def figures(number: int, values: Values) -> Figures:
    """Return the means over the seeds."""
    found = []
    for seed in SEEDS:
        touches = align_at_switch([table(number, values, seed)], up=True)
        chatter = np.mean([np.std(step.mu[step.time_ms <= 0]) for step in touches.steps])
        rise, overshoot = map(touches.of_mean_curve, (rise_time, overshoot_percent))
        found.append((rise, overshoot, float(chatter)))
    return Figures(*np.mean(found, axis=0).tolist())


def objective(number: int, values: Values) -> tuple[float, Figures | None]:
    """Return the objective, infinite for a finger that is out, and the figures behind it."""
    try:
        found = figures(number, values)
    except (ValueError, UndefinedError):
        return inf, None
    if found.chatter > CHATTER_MAX:
        return inf, found
    rise = (found.rise - RISE_TIMES_MS[number - 1]) / 0.5
    overshoot = (found.overshoot - OVERSHOOTS_PERCENT[number - 1]) / 5.0
    return rise * rise + overshoot * overshoot, found


def fit(number: int) -> tuple[Values, Figures | None]:
    """Walk to the finger of a subject, 1..4; its numbers are rounded to three digits."""
    rng = np.random.default_rng([number, 0x46])
    best: Values = dict(zip(FREE, START[number], strict=True))
    least, found = objective(number, best)
    size = FIRST_STEP
    for _ in range(STEPS):
        if least < ENOUGH:
            break
        trial = {}
        for name, bounds in FREE.items():
            value = np.clip(best[name] * exp(size * rng.standard_normal()), *bounds)
            trial[name] = float(f"{value:.3g}")
        score, made = objective(number, trial)
        if score < least:
            best, least, found = trial, score, made
            size *= 1.5
            print(f"  {number}: {least:7.3f} {best} {found}", file=sys.stderr, flush=True)
        else:
            size *= 0.92
    return best, found


def main() -> None:
    """Fit the subjects of the command line, or all; print them as data for plant/fitted.py."""
    parser = parser_of(__doc__)
    parser.add_argument("subject", nargs="*", type=int, default=[*START], help="1..4")
    for number in parser.parse_args().subject:
        values, found = fit(number)
        mu0 = finger(number, values).mu0
        free = ", ".join(f"{values[name]:g}" for name in FREE)
        print(f"    _fitted({number}, {mu0:.3f}, {free}),  # {found}")
