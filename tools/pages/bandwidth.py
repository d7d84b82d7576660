"""Measure how fast the COF follows its reference, and write docs/reference/bandwidth.md; minutes.

Two processes share the work. Example: tools/pages/make bandwidth --check --seed 2
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
import textures
from pages import EXPLANATION, REFERENCE, Pages, columns, made, renewed
from texture_playing import LEVELS, play

from smarttac_can.assurance.trials.workers import sharing
from smarttac_can.bench.drawing import GREEN, INK, RED, canvas, save
from smarttac_can.bench.textures import Texture, track
from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.texture import texture_of
from smarttac_can.science.control.tribometer import calibration
from smarttac_can.science.plant.finger import Stroke, ramp_of
from smarttac_can.science.plant.friction import bare_friction, friction_map, sliding_friction
from smarttac_can.science.plant.parameters import PlateParameters
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.skin import skin_of
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.science.population.fingers import CASES, draw_finger
from smarttac_can.science.population.trial import Campaign, outcome_of
from smarttac_can.vocabulary.signals import TICK, Drive, Setpoint
from smarttac_can.vocabulary.states import Law, Mode, VibrationLaw
from smarttac_can.vocabulary.textures import COF_COUNT, Axis, TextureTable

WEBER: Final = 0.11
"""Just noticeable change of friction over friction; Gueorguiev et al., J. R. Soc. Interface 14
(2017) 20170641."""
FREQUENCIES: Final = (1, 2, 5, 10, 20, 30, 50, 70, 100, 150, 200, 250, 300, 400)
SHOWN: Final = (10, 50, 100, 200, 400)
SPEEDS: Final = (30.0, 60.0, 120.0)
SWINGS: Final = (0.02, 0.05, 0.1)
FORCE: Final = 1.0
F0: Final = 43_390.0
VALUES: Final = 100
"""Of the table of a period."""
BEGIN, TARE, LEARNT, TICKS = 150, 100, 1000, 3000
"""Ticks at which the mode begins, the tare is taken, the fit begins, and a run ends."""
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


def answer(
    condition: Condition, subject: int, speed: float, swing: float, frequency: int, seed: int
) -> Answer:
    """Stroke for 3 s while the reference is a sine, and fit one to the steady slide.

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
    stroke = Stroke(FORCE, speed * 1e-3, 0.05, force_variation=0.0, speed_variation=0.0, seed=seed)
    parameters = PlateParameters()
    plate = Plate(
        parameters, SUBJECTS[subject - 1], stroke, seed=seed, dead_time=condition.dead_time
    )
    cascade = Cascade(
        CascadeParameters(
            law=condition.law,
            vibration_law=condition.vibration_law,
            dead_time=condition.dead_time,
            lateral=calibration(parameters.sensors.crosstalk),
        )
    )
    cascade.play(texture_of(TextureTable(Axis.TIME, True, 0, step, values)))
    old, rows = Drive(0.0, F0), []
    for tick in range(TICKS):
        if tick == TARE:
            cascade.zero = cascade.null()
        if tick == BEGIN:
            cascade.set_mode(condition.mode)
        mu = middle + 0.5 * swing * float(np.sin(omega * (tick - BEGIN) * TICK))
        drive = cascade.update(plate.sample(), Setpoint(0.0, F0, 1e-6, mu, mu, 0.0))
        rows.append((plate.mu_true, cascade.W_ref, abs(plate.W)))
        plate.step(old, drive)
        old = drive
    slides = steady(stroke)
    time = (np.flatnonzero(slides) - BEGIN) * TICK
    basis = np.column_stack((np.sin(omega * time), np.cos(omega * time), np.ones(len(time))))
    kept = np.array(rows)[slides]
    fitted = np.linalg.lstsq(basis, kept, rcond=None)[0]
    mu, W_ref, W = fitted[0] + 1j * fitted[1]
    rest = kept[:, 0] - basis @ fitted[:, 0]
    asked = 0.5 * swing
    stages = (abs(W_ref) / asked, abs(W / W_ref), abs(mu / W))
    return Answer(mu / asked, 1.0 - float(np.var(rest) / np.var(kept[:, 0])), stages)


def steady(stroke: Stroke) -> np.ndarray[Any, Any]:
    """Return in which ticks a finger slides at its speed, 40 ms after its turn and later."""
    slides = np.zeros(TICKS, dtype=bool)
    for now in stroke.passes(20):
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
"""Of a condition and a swing, over subjects, and with the middle swing over speeds."""


def curves(seed: int) -> Curves:
    """Return all curves."""
    with sharing(2) as submit:
        waiting = {
            (condition, swing): [
                submit(curve, condition, subject, speed, swing, seed)
                for subject in LEVELS
                for speed in (SPEEDS if swing == SWINGS[1] else SPEEDS[1:2])
            ]
            for condition, swing in product(CONDITIONS, SWINGS)
        }
        return {key: [one.result() for one in ones] for key, ones in waiting.items()}


def bandwidth(found: Curve) -> float:
    """Return where the gain falls below -3 dB in Hz; 0 if it is below at 1 Hz."""
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
    """Return the median, and the lowest in brackets."""
    median, least = float(np.median(values)), min(values)
    most = FREQUENCIES[-1]
    return " ".join(
        text.format("> " * (value >= most) + f"{value:.0f}")
        for text, value in (("{}", median), ("({})", least))
    )


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
    """Return the table of gain, phase and coherence: medians over subjects and speeds."""
    rows = []
    for condition in CONDITIONS:
        cells = []
        for at in map(FREQUENCIES.index, SHOWN):
            ones = [one[at] for one in found[condition, SWINGS[1]]]
            middle = np.median([abs(one.gain) for one in ones])
            phase = np.degrees(np.angle(np.sum([one.gain / abs(one.gain) for one in ones])))
            cells.append(f"{middle:.2f} {phase:.0f} {np.median([o.coherence for o in ones]):.2f}")
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


def correlation(vibration_law: VibrationLaw, period: float, speed: float, seed: int) -> float:
    """Return the mean correlation of single passes over a sine of a period in mm; subject 2."""
    texture = Texture.grating(period, *LEVELS[2], shape="sine")
    played = play(
        texture,
        2,
        speed=speed,
        force=FORCE,
        seed=seed,
        dead_time_us=540,
        vibration_law=vibration_law,
    )
    return float(np.mean(track(texture, played.position, played.cof).correlations))


def gratings(seed: int) -> Iterator[str]:
    """Return how gratings are followed, by period and speed."""
    rows = []
    for law in (VibrationLaw.PI, VibrationLaw.PREDICTIVE):
        for speed in SPEEDS:
            cells = [
                f"{correlation(law, period, speed, seed):.2f}, {speed / period:g} Hz"
                for period in PERIODS
            ]
            rows.append((f"`{law.name.lower()}`", f"{speed:g}", *cells))
    return columns("Law|mm/s|" + "|".join(f"{period:g} mm" for period in PERIODS), rows)


@cache
def in_jnd(
    law: Law, vibration_law: VibrationLaw, dead_time: float, seed: int
) -> np.ndarray[Any, Any]:
    """Return static error, overshoot and chatter of the true COF in JND, a row a finger."""
    campaign = Campaign(seed, law, vibration_law, dead_time)
    rows = []
    for number in range(FINGERS):
        finger = draw_finger(campaign.seed, number, CASES[campaign.case])
        true = outcome_of(campaign, number)[0].true
        step = finger.mu_right - finger.mu_left
        middle = 0.5 * (finger.mu_right + finger.mu_left)
        rows.append(
            (
                0.01 * true.static_error_percent / WEBER,
                0.01 * true.overshoot_percent * step / (WEBER * finger.mu_right),
                true.chatter / (WEBER * middle),
            )
        )
    return np.array(rows)


def felt(seed: int) -> Iterator[str]:
    """Return the table of errors in JND: of fingers of a campaign, and of gratings."""
    rows = []
    for condition in CONDITIONS:
        if condition.mode is Mode.TEXTURE:
            conditions = textures.Conditions(
                dead_time_us=round(1e6 * condition.dead_time),
                vibration_law=condition.vibration_law,
                seed=seed,
            )
            cells = ["", "", ""]
            for shape in textures.SHAPES:
                errors = [
                    textures.tracked(subject, shape, conditions).rms / (WEBER * np.mean(levels))
                    for subject, levels in LEVELS.items()
                ]
                cells.append(f"{np.median(errors):.2f} ({max(errors):.2f})")
        else:
            found = in_jnd(condition.law, condition.vibration_law, condition.dead_time, seed)
            high = np.nanquantile(found, (0.5, 0.95), axis=0, method="inverted_cdf")
            cells = [f"{middle:.2f} ({most:.2f})" for middle, most in high.T] + ["", ""]
        rows.append((*name(condition), *cells))
    return columns("Law|Dead time, us|static|step|chatter|sine|square", rows)


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
    """Draw the errors of the friction laws in JND: median, and up to the 95th percentile."""
    laws = [
        condition
        for condition in CONDITIONS
        if condition.mode is Mode.FRICTION and condition.dead_time
    ]
    with canvas(7.2, 2.6) as figure:
        panels = figure.subplots(1, 3, sharey=True)
        for axes, at, error in zip(panels, range(3), ("static", "step", "chatter"), strict=True):
            for row, condition in enumerate(laws):
                found = in_jnd(condition.law, condition.vibration_law, condition.dead_time, seed)[
                    :, at
                ]
                middle, most = np.nanquantile(found, (0.5, 0.95), method="inverted_cdf")
                axes.plot([0.0, most], [row, row], color=INK, lw=1.0)
                axes.plot(middle, row, "o", color=RED)
            axes.axvline(1.0, color=INK, lw=0.8, ls=":")
            axes.set(xlabel=f"{error} (JND)", xlim=(0, 4))
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
