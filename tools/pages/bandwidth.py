"""Measure how fast the COF follows its reference, and write docs/reference/bandwidth.md; minutes.

The loop is compiled if numba is installed, and takes hours otherwise.

Example: tools/pages/make bandwidth --check --seed 2
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
import textures
from pages import EXPLANATION, REFERENCE, Pages, columns, made, renewed
from texture_playing import LEVELS

from smarttac_can.bench.drawing import GREEN, INK, RED, canvas, save
from smarttac_can.bench.textures import Texture, track
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.step import (
    ControlPlan,
    adopted,
    at_rest,
    control_plan,
    control_step,
)
from smarttac_can.science.control.texture import texture_of
from smarttac_can.science.control.tribometer import Forces, calibration
from smarttac_can.science.plant.finger import Path, Stroke, ramp_of
from smarttac_can.science.plant.friction import bare_friction, friction_map, sliding_friction
from smarttac_can.science.plant.motion import PlatePlan, coefficients, measured, plate_step
from smarttac_can.science.plant.motion import at_rest as plate_at_rest
from smarttac_can.science.plant.parameters import PlateParameters
from smarttac_can.science.plant.sensors import NOISE_BLOCK, noise_block, sensing
from smarttac_can.science.plant.skin import skin_of
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.science.population.compiled import can_compile, compiled
from smarttac_can.science.population.fingers import CASES, draw_finger
from smarttac_can.science.population.steps import Floats
from smarttac_can.science.population.trial import Campaign, Loop, finger_at, outcome_of
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import TICK, Setpoint
from smarttac_can.vocabulary.states import Law, Mode, VibrationLaw
from smarttac_can.vocabulary.textures import COF_COUNT, Axis, TextureTable

WEBER: Final = 0.11
"""Just noticeable change of friction over friction; Gueorguiev et al., J. R. Soc. Interface 14
(2017) 20170641."""
VIBRATION: Final = 4.0
"""Amplitude in um (rms) of a vibration of 31.5 Hz that a fingertip detects [A]. Measured in Morioka
et al., Somatosens. Mot. Res. 25 (2008), of which the abstract was read: it has no figures."""
FREQUENCIES: Final = (5, 10, 20, 50, 70, 100, 150, 200, 300, 400)
SHOWN: Final = (10, 50, 100, 200, 400)
SPEEDS: Final = (30.0, 60.0, 120.0)
SWINGS: Final = (0.02, 0.05, 0.1)
FORCE: Final = 1.0
F0: Final = 43_390.0
VALUES: Final = 100
"""Of the table of a period."""
TARE, LEARNT, TICKS = 1024, 1500, 3500
"""Ticks at which the tare is taken and the mode begins, the fit begins, and a run ends."""
SEEDS: Final = 3
"""Runs of stroke and noise for each subject and speed."""
SETTLED: Final = 0.04
"""Time in s after the turn of a pass from which it counts."""
HALF_POWER: Final = 0.5**0.5
DEAD_TIMES: Final = (0.0, 540e-6)
FINGERS: Final = 200


class Condition(NamedTuple):
    """A controller of the page."""

    name: str
    mode: Mode
    law: Law
    vibration_law: VibrationLaw
    dead_time: float
    """In s, known to the controllers."""


CONDITIONS: Final = tuple(
    Condition(name, mode, law, vibration_law, dead_time)
    for (name, mode, law, vibration_law), dead_time in product(
        (
            ("`measured`", Mode.FRICTION, Law.MEASURED, VibrationLaw.PI),
            ("`accumulate`", Mode.FRICTION, Law.ACCUMULATE, VibrationLaw.PI),
            ("`nominal`", Mode.FRICTION, Law.NOMINAL, VibrationLaw.PI),
            ("`predictive`", Mode.FRICTION, Law.PREDICTIVE, VibrationLaw.PREDICTIVE),
            ("texture, `pi`", Mode.TEXTURE, Law.MEASURED, VibrationLaw.PI),
            ("texture, `predictive`", Mode.TEXTURE, Law.MEASURED, VibrationLaw.PREDICTIVE),
        ),
        DEAD_TIMES,
    )
)


class Answer(NamedTuple):
    """How the COF answers a sine of its reference."""

    gain: complex
    """COF over its reference."""
    coherence: float
    """Share of the variance of the COF that is this sine."""
    stages: tuple[float, float, float]
    """Gains of reference to W_ref, to the amplitude, to the COF; in m and 1/m."""


def loop(
    plans: tuple[PlatePlan, ControlPlan],
    stroke: tuple[Path, Floats],
    state: Loop,
    asked: tuple[int, Floats],
    noise: Floats,
    traces: Floats,
) -> tuple[Loop, Forces]:
    """Run plate and controllers in one mode, while the reference moves.

    Parameters
    ----------
    plans
        Of plate and controllers.
    stroke
        Path, and a row for each pass.
    state
        State in which the run begins.
    asked
        Mode, and COF reference of each tick in mode FRICTION.
    noise
        A row of 9 values for each tick, and for the one after the last.
    traces
        Array to fill, a row per tick: true COF, W_ref, ``|W|`` and position, in m.

    Returns
    -------
    state, sums
        State at the end, and the sums of the samples of S1..S6 in N.
    """
    plate_plan, plan = plans
    path, passes = stroke
    mode, mu = asked
    first, plate, measurement, controls = state
    s1 = s2 = s3 = s4 = s5 = s6 = 0.0
    number = 0
    finger = finger_at(path, passes, number, first * TICK, False)
    last = len(noise) - 1
    for tick in range(first, last):
        before = controls.drive
        setpoint = Setpoint(0.0, F0, 1e-6, mu[tick], mu[tick], 0.0)
        controls, _ = control_step(plan, controls, mode, measurement, setpoint)
        traces[tick, 0] = abs(plate.motion.Ft) / finger[1] if finger[1] > 0.0 else 0.0
        traces[tick, 1] = controls.W_ref
        traces[tick, 2] = abs(plate.motion.W)
        traces[tick, 3] = finger[0]
        g1, g2, g3, g4, g5, g6 = measurement[1]
        s1, s2, s3, s4, s5, s6 = s1 + g1, s2 + g2, s3 + g3, s4 + g4, s5 + g5, s6 + g6
        time = (tick + 1) * TICK
        while number + 1 < len(passes) and time >= passes[number + 1][0]:
            number += 1
        finger_next = finger_at(path, passes, number, time, False)
        drives = (before, controls.drive)
        plate, measurement = plate_step(
            plate_plan, plate, drives, (finger, finger_next), noise[tick + 1]
        )
        finger = finger_next
    return Loop(last, plate, measurement, controls), (s1, s2, s3, s4, s5, s6)


@cache
def fastest() -> Callable[..., Any]:
    """Return the loop, compiled if possible."""
    return compiled(loop) if can_compile() else loop


def run(
    condition: Condition, subject: int, stroke: Stroke, table: TextureTable, mu: Floats, seed: int
) -> Floats:
    """Return the traces of `loop`, from the first tick on.

    Parameters
    ----------
    condition
        The laws.
    subject
        Number of the finger.
    stroke
        Its motion.
    table
        Texture of mode TEXTURE.
    mu
        COF reference of each tick of mode FRICTION.
    seed
        Of the noise.
    """
    parameters = PlateParameters()
    dead_time = condition.dead_time
    made = coefficients(
        parameters, SUBJECTS[subject - 1], ambient=20.0, dead_time=dead_time, sound_f0=F0
    )
    plate_plan = PlatePlan(made, sensing(parameters.sensors))
    values: Any = np.array(table.values, dtype=np.float64)
    plan = control_plan(
        CascadeParameters(
            law=condition.law,
            vibration_law=condition.vibration_law,
            dead_time=dead_time,
            lateral=calibration(parameters.sensors.crosstalk),
        ),
        PlateModel(),
        texture=texture_of(table)._replace(values=values),
    )
    rows: Any = np.array(plan.rows)
    plan = plan._replace(rows=rows)
    ticks = len(mu)
    blocks = range(ticks // NOISE_BLOCK + 1)
    noise = np.concatenate([noise_block(parameters.sensors, seed, n) for n in blocks])[: ticks + 1]
    rest = plate_at_rest(20.0)
    state = Loop(0, rest, measured(plate_plan, rest, noise[0].tolist()), at_rest(plan))
    traces = np.empty((ticks, 4))
    passes = stroke.path, np.array(stroke.passes(2 + int(ticks * TICK / 0.2)))
    step, plans = fastest(), (plate_plan, plan)
    off, on = (int(Mode.OFF), mu), (int(condition.mode), mu)
    state, sums = step(plans, passes, state, off, noise[: TARE + 1], traces)
    tared = plan._replace(zero=tuple([total / TARE for total in sums]))
    state = state._replace(controls=adopted(plan, tared, state.controls))
    step((plate_plan, tared), passes, state, on, noise, traces)
    return traces


def answer(
    condition: Condition, subject: int, speed: float, swing: float, frequency: int, seed: int
) -> Answer:
    """Stroke for 2.3 s while the reference is a sine, and fit one to the steady slide.

    Parameters
    ----------
    condition
        The laws.
    subject
        Number of the finger.
    speed
        In mm/s.
    swing
        Of the reference, from peak to peak.
    frequency
        In Hz; the nearest one of which a period is 100 steps of whole us.
    seed
        Of stroke and noise.
    """
    step = round(1e6 / VALUES / frequency)
    omega = 2.0 * np.pi * 1e6 / VALUES / step
    middle = float(np.mean(LEVELS[subject]))
    period = middle + 0.5 * swing * np.sin(2.0 * np.pi * np.arange(VALUES) / VALUES)
    values = tuple(np.round(period / COF_COUNT).astype(int).tolist())
    stroke = stroking(FORCE, speed, 0.05, seed)
    mu = middle + 0.5 * swing * np.sin(omega * (np.arange(TICKS) - TARE) * TICK)
    traces = run(
        condition, subject, stroke, TextureTable(Axis.TIME, True, 0, step, values), mu, seed
    )
    slides = steady(stroke)
    time = (np.flatnonzero(slides) - TARE) * TICK
    basis = np.column_stack((np.sin(omega * time), np.cos(omega * time), np.ones(len(time))))
    kept = traces[slides, :3]
    fitted = np.linalg.lstsq(basis, kept, rcond=None)[0]
    mu_found, W_ref, W = fitted[0] + 1j * fitted[1]
    rest = kept[:, 0] - basis @ fitted[:, 0]
    asked = 0.5 * swing
    stages = (abs(W_ref) / asked, abs(W / W_ref), abs(mu_found / W))
    return Answer(mu_found / asked, 1.0 - float(np.var(rest) / np.var(kept[:, 0])), stages)


def stroking(force: float, speed: float, travel: float, seed: int) -> Stroke:
    """Return a stroke, of a force in N, a speed in mm/s and a travel in m, after the tare."""
    rest = (TARE + 20) * TICK
    return Stroke(
        force, 1e-3 * speed, travel, force_variation=0.0, speed_variation=0.0, seed=seed, rest=rest
    )


def steady(stroke: Stroke) -> np.ndarray[Any, Any]:
    """Return in which ticks a finger slides at its speed, 40 ms after its turn and later."""
    slides = np.zeros(TICKS, dtype=bool)
    for now in stroke.passes(2 + int(TICKS * TICK / 0.2)):
        ramp = ramp_of(stroke.path, now)
        end = now.start + now.duration - ramp
        slides[round((now.start + ramp + SETTLED) / TICK) : round(end / TICK)] = True
    slides[:LEARNT] = False
    return slides


Curve = tuple[Answer, ...]


def curve(condition: Condition, subject: int, speed: float, swing: float, seed: int) -> Curve:
    """Return the answers at all frequencies."""
    return tuple(answer(condition, subject, speed, swing, each, seed) for each in FREQUENCIES)


Curves = dict[tuple[Condition, float], list[Curve]]
"""Of a condition and a swing, over subjects and seeds, and with the middle swing over speeds."""


def curves(seed: int) -> Curves:
    """Return all curves."""
    return {
        (condition, swing): [
            curve(condition, subject, speed, swing, 1000 * seed + number)
            for number, (_, subject, speed) in enumerate(
                product(range(SEEDS), LEVELS, SPEEDS if swing == SWINGS[1] else SPEEDS[1:2])
            )
        ]
        for condition, swing in product(CONDITIONS, SWINGS)
    }


def bandwidth(found: Curve) -> float:
    """Return where the gain falls below -3 dB in Hz; 0 if it is below at 5 Hz."""
    gains = np.array([abs(one.gain) for one in found])
    below = np.flatnonzero(gains < HALF_POWER)
    if not len(below):
        return float(FREQUENCIES[-1])
    last = int(below[0])
    if not last:
        return 0.0
    share = (HALF_POWER - gains[last - 1]) / (gains[last] - gains[last - 1])
    low, high = np.log(FREQUENCIES[last - 1 : last + 1])
    return float(np.exp(low + share * (high - low)))


def hertz(values: Sequence[float]) -> str:
    """Return the median, and the range in brackets."""
    most = FREQUENCIES[-1]
    median, low, high = (
        "> " * (value >= most) + f"{value:.0f}"
        for value in (float(np.median(values)), min(values), max(values))
    )
    return f"{median} ({low} to {high})"


def spread(values: Sequence[float]) -> str:
    """Return the median of gains, and their range in brackets."""
    return f"{np.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def name(condition: Condition) -> tuple[str, str]:
    """Return the first cells of a row."""
    return condition.name, f"{1e6 * condition.dead_time:.0f}"


def edges(found: Curves) -> Iterator[str]:
    """Return the table of -3 dB."""
    rows = [
        (
            *name(condition),
            *(hertz([bandwidth(one) for one in found[condition, swing]]) for swing in SWINGS),
        )
        for condition in CONDITIONS
    ]
    return columns("Law|Dead time, us|" + "|".join(f"swing {swing:g}" for swing in SWINGS), rows)


def answers(found: Curves) -> Iterator[str]:
    """Return the table of gain, phase and coherence: medians over subjects, speeds and seeds."""
    rows = []
    for condition in CONDITIONS:
        cells = []
        for at in map(FREQUENCIES.index, SHOWN):
            ones = [one[at] for one in found[condition, SWINGS[1]]]
            gains = spread([abs(one.gain) for one in ones])
            phase = np.degrees(np.angle(np.sum([one.gain / abs(one.gain) for one in ones])))
            cells.append(f"{gains}, {phase:.0f}, {np.median([o.coherence for o in ones]):.2f}")
        rows.append((*name(condition), *cells))
    return columns("Law|Dead time, us|" + "|".join(f"{f} Hz" for f in SHOWN), rows)


@cache
def skin_gain(subject: int, speed: float, frequency: int) -> float:
    """Return by how much a small swing of the friction falls off from 5 Hz on, by the skin.

    Friction acts over the way L. To pull more the skin stretches, too, and while it does its speed
    falls behind the bone's. Around a slide at the speed v and the middle of the references
    ``Z = skin_mass s + b + k/(s c)`` holds the skin to the bone, with the creep
    ``c = 1 + creep_ratio/(1 + creep_time s)``, and the friction is F = F_W W + F_v v. So the force
    follows W by ``F_W/(1 + s L/v + F_v/Z)``.
    """
    finger = SUBJECTS[subject - 1]
    friction, skin = friction_map(finger, F0), skin_of(finger)
    bare = bare_friction(friction, FORCE, 0.0)
    middle = float(np.mean(LEVELS[subject])) * FORCE

    slopes = [sliding_friction(friction, bare, 1e-9 * nm, 1e-3 * speed) for nm in range(5000)]
    _, per_v, _ = min(slopes, key=lambda each: abs(each[0] - middle))

    def force(hertz: float) -> complex:
        s = 2j * np.pi * hertz
        creep = 1.0 + skin.creep_ratio / (1.0 + skin.creep_time * s)
        Z = skin.mass * s + skin.b + skin.k / (s * creep)
        return complex(1.0 / (1.0 + s * skin.L / (1e-3 * speed) + per_v / Z))

    return abs(force(frequency) / force(5.0))


def stages(found: Curves) -> Iterator[str]:
    """Return by how much each stage of mode texture falls off from 5 Hz on."""
    first, rows = FREQUENCIES.index(5), []
    for condition in CONDITIONS:
        if condition.mode is not Mode.TEXTURE:
            continue
        for at in map(FREQUENCIES.index, (100, 200, 400)):
            ones = found[condition, SWINGS[1]]
            falls = [np.divide(one[at].stages, one[first].stages) for one in ones]
            skins = [skin_gain(*each, FREQUENCIES[at]) for each in product(LEVELS, SPEEDS)]
            medians = (*np.median(falls, axis=0), np.median(skins))
            cells = (f"{value:.2f}" for value in medians)
            rows.append((*name(condition), str(FREQUENCIES[at]), *cells))
    head = "Law|Dead time, us|Hz|reference to W_ref|to amplitude|to COF|skin, computed"
    return columns(head, rows)


PERIODS: Final = (4.0, 2.0, 1.0, 0.5)
FORCES: Final = (1.0, 0.5)
STROKED: Final = 6000
"""Ticks of a run over a grating; 1 s of them before the mode begins."""


def over_position(
    vibration_law: VibrationLaw, force: float, period: float, speed: float, subject: int, seed: int
) -> tuple[float, float]:
    """Return mean correlation of single passes over a sine of a period in mm, and gain in phase."""
    texture = Texture.grating(period, *LEVELS[subject], shape="sine")
    condition = Condition("", Mode.TEXTURE, Law.MEASURED, vibration_law, DEAD_TIMES[1])
    stroke = stroking(force, speed, 0.03, seed)
    mu = np.full(STROKED, np.mean(LEVELS[subject]))
    traces = run(condition, subject, stroke, texture.table, mu, seed)[LEARNT:]
    found = track(texture, 1e3 * traces[:, 3], traces[:, 0])
    return float(np.mean(found.correlations)), found.harmonics[0].gain


def gratings(seed: int) -> Iterator[str]:
    """Return how gratings are followed, by force, period and speed, over subjects and seeds."""
    rows = []
    laws = (VibrationLaw.PI, VibrationLaw.PREDICTIVE)
    for law, force, speed in product(laws, FORCES, SPEEDS):
        cells = []
        for period in PERIODS:
            found = [
                over_position(law, force, period, speed, subject, 1000 * seed + number)
                for number, (_, subject) in enumerate(product(range(SEEDS), LEVELS))
            ]
            correlations, gains = zip(*found, strict=True)
            cells.append(f"{speed / period:g} Hz: {np.median(correlations):.2f}, {spread(gains)}")
        rows.append((f"`{law.name.lower()}`", f"{force:g}", f"{speed:g}", *cells))
    return columns("Law|N|mm/s|" + "|".join(f"{period:g} mm" for period in PERIODS), rows)


@cache
def as_felt(
    law: Law, vibration_law: VibrationLaw, dead_time: float, seed: int
) -> np.ndarray[Any, Any]:
    """Return static error and overshoot in JND, chatter in um of the skin, a row a finger."""
    campaign = Campaign(seed, law, vibration_law, dead_time)
    rows = []
    for number in range(FINGERS):
        finger = draw_finger(campaign.seed, number, CASES[campaign.case])
        true = outcome_of(campaign, number)[0].true
        step = finger.mu_right - finger.mu_left
        rows.append(
            (
                0.01 * true.static_error_percent / WEBER,
                0.01 * true.overshoot_percent * step / (WEBER * finger.mu_right),
                1e6 * true.chatter * finger.force / finger.subject.skin_stiffness,
            )
        )
    return np.array(rows)


def felt(seed: int) -> Iterator[str]:
    """Return the table of errors as they are felt: of fingers of a campaign, and of gratings."""
    rows = []
    for condition in CONDITIONS:
        if condition.mode is Mode.TEXTURE:
            conditions = textures.Conditions(
                dead_time_us=round(1e6 * condition.dead_time),
                vibration_law=condition.vibration_law,
                seed=seed,
            )
            cells = ["", "", "", ""]
            for shape in textures.SHAPES:
                errors = [
                    textures.tracked(subject, shape, conditions).rms / (WEBER * np.mean(levels))
                    for subject, levels in LEVELS.items()
                ]
                cells.append(f"{np.median(errors):.2f} ({max(errors):.2f})")
        else:
            found = as_felt(condition.law, condition.vibration_law, condition.dead_time, seed)
            high = np.nanquantile(found, (0.5, 0.95), axis=0, method="inverted_cdf")
            static, step, chatter = (f"{middle:.2f} ({most:.2f})" for middle, most in high.T)
            above = f"{100 * np.mean(found[:, 2] > VIBRATION):.0f}"
            cells = [static, step, chatter, above, "", ""]
        rows.append((*name(condition), *cells))
    return columns("Law|Dead time, us|static|step|chatter, um|above 4 um, %|sine|square", rows)


LINES: Final = {
    CONDITIONS[1].name: (INK, ":"),
    CONDITIONS[7].name: (GREEN, "--"),
    CONDITIONS[9].name: (RED, "-."),
    CONDITIONS[11].name: (RED, "-"),
}


def picture(found: Curves) -> None:
    """Draw gain, phase and coherence with the dead time of a bus."""
    with canvas(7.2, 7.6) as figure:
        panels = figure.subplots(3, 1, sharex=True)
        for condition in CONDITIONS:
            if condition.name not in LINES or not condition.dead_time:
                continue
            colour, style = LINES[condition.name]
            ones = found[condition, SWINGS[1]]
            gains = np.array([[one.gain for one in curve] for curve in ones])
            coherences = np.array([[one.coherence for one in curve] for curve in ones])
            phases = np.degrees(np.unwrap(np.angle(np.sum(gains / np.abs(gains), axis=0))))
            values = (np.median(np.abs(gains), axis=0), phases, np.median(coherences, axis=0))
            label = condition.name.replace("`", "")
            for axes, value in zip(panels, values, strict=True):
                axes.semilogx(FREQUENCIES, value, color=colour, ls=style, lw=1.6, label=label)
            panels[0].fill_between(
                FREQUENCIES,
                np.abs(gains).min(axis=0),
                np.abs(gains).max(axis=0),
                color=colour,
                alpha=0.1,
                lw=0,
            )
        panels[0].axhline(HALF_POWER, color=INK, lw=0.8, ls=":")
        panels[0].set(ylim=(0, 1.6), ylabel="gain", title="COF over its reference (simulated)")
        panels[1].set(ylabel="phase (deg)")
        panels[2].set(ylim=(0, 1.02), ylabel="coherence", xlabel="frequency (Hz)")
        panels[2].legend(loc="lower left")
        save(figure, EXPLANATION / "figures" / "bandwidth.png")


def felt_picture(seed: int) -> None:
    """Draw the errors of the friction laws as felt: median, and up to the 95th percentile."""
    laws = [
        condition
        for condition in CONDITIONS
        if condition.mode is Mode.FRICTION and condition.dead_time
    ]
    with canvas(7.2, 2.6) as figure:
        panels = figure.subplots(1, 3, sharey=True)
        for axes, at, error in zip(panels, range(3), ("static", "step", "chatter"), strict=True):
            for row, condition in enumerate(laws):
                found = as_felt(condition.law, condition.vibration_law, condition.dead_time, seed)[
                    :, at
                ]
                middle, most = np.nanquantile(found, (0.5, 0.95), method="inverted_cdf")
                axes.plot([0.0, most], [row, row], color=INK, lw=1.0)
                axes.plot(middle, row, "o", color=RED)
            threshold, unit = (VIBRATION, "µm") if error == "chatter" else (1.0, "JND")
            axes.axvline(threshold, color=INK, lw=0.8, ls=":")
            axes.set(xlabel=f"{error} ({unit})", xlim=(0, 4 * threshold))
        panels[0].set_yticks(
            range(len(laws)), [condition.name.replace("`", "") for condition in laws]
        )
        panels[0].invert_yaxis()
        figure.suptitle("Errors of 200 fingers with 540 us: median, and up to 95 % (simulated)")
        save(figure, EXPLANATION / "figures" / "jnd.png")


def pages(draw: bool, seed: int) -> Pages:
    """Return the page, and draw its pictures."""
    found = curves(seed)
    if draw:
        picture(found)
        felt_picture(seed)
    fields = {
        "edges": edges(found),
        "answers": answers(found),
        "stages": stages(found),
        "gratings": gratings(seed),
        "felt": felt(seed),
    }
    return renewed(REFERENCE / "bandwidth.md", fields)


def main() -> int:
    """Write the page, or compare it."""
    return made(__doc__, pages, seed=1)
