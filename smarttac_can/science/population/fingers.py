"""Random fingers and plates, each a function of the campaign's seed and its own number."""

from __future__ import annotations

from dataclasses import replace
from math import exp, inf, log, sqrt
from statistics import NormalDist
from typing import Final, NamedTuple

import numpy as np

from smarttac_can.science.plant.finger import Stroke, smooth
from smarttac_can.science.plant.friction import sliding_coefficient
from smarttac_can.science.plant.parameters import LEAST_WINDOW, ResonatorParameters
from smarttac_can.science.plant.subjects import SUBJECTS, Subject
from smarttac_can.vocabulary.model import PlateModel


class Case(NamedTuple):
    """A mismatch between plate and controllers, or a kind of finger."""

    path_frequency: float = 1.0
    """Factor of the force path's natural frequency."""
    path_damping: float | None = None
    """Damping ratio of the force path; None for that of the plate."""
    slope: float = 1.0
    """Factor of the friction law's step per % of error."""
    variation: float = 0.2
    """Half-width of the range of force and speed from pass to pass, as a fraction."""
    stribeck: float | None = None
    """Stribeck ratio of all fingers; None for random ones."""
    lifts: bool = False
    """Whether the finger lifts every second, for 0.1 s."""
    sweats: bool = False
    """Whether mu0 rises, by 5 % per second at first, to three times its value."""
    film_lag: float = 0.0
    """Time constant of the squeeze film in s."""
    ripple: float = 0.0
    """Variation of the amplitude under a moving finger, as a fraction."""
    wider: float = 0.0
    """Increase of the ranges of the fingers, as a fraction."""
    coupling: float = 0.0
    """Correlation, 0..1, with which a finger of more damping loses its friction at less amplitude:
    between the normal scores of load_damping and -W0, before maps with too small a span are redrawn
    [sign: Friesen 2016; size: an assumption]."""


CASES: Final[dict[str, Case]] = {
    "nominal": Case(),
    "path-slower": Case(path_frequency=0.7),
    "path-faster": Case(path_frequency=1.3),
    "path-ringing": Case(path_damping=0.5),
    "slope-low": Case(slope=0.5),
    "slope-high": Case(slope=1.5),
    "uneven": Case(variation=0.5),
    "stribeck": Case(stribeck=1.5),
    "lifting": Case(lifts=True),
    "sweating": Case(sweats=True),
    "film-lag": Case(film_lag=2e-3),
    "mode-shape": Case(ripple=0.1),
    "wider": Case(wider=0.2),
    "coupled": Case(coupling=0.8),
}
"""The cases by name."""


AMBIENT: Final = 20.0
"""Temperature in degC at the beginning of the plate of the model and its surroundings."""


class Plate(NamedTuple):
    """A plate of a population, and the model by which its laws are designed."""

    resonator: ResonatorParameters = ResonatorParameters()
    window: float = 0.0
    """Window of the pick-up in s."""
    ambient: float = AMBIENT
    """Temperature in degC at the beginning."""
    excess: float = 0.0
    """Dead time that the laws assume minus the true one, in s."""
    model: PlateModel = PlateModel()
    """Model by which the laws are designed."""


MODEL_PLATE: Final = Plate()
PLATES: Final = ("model", "varied", "identified")
"""The plate of the model, random plates, or random plates for which the laws are designed."""
PLATE_RANGES: Final = {
    "softening": (0.0, 150e6),
    "neighbour_share": (0.1, 0.3),
    "neighbour_offset": (300.0, 900.0),
    "pickup_window": (0.0, 0.5e-3),
    "tau": (0.8, 1.2),
    "gain": (0.8, 1.2),
    "temperature": (15.0, 35.0),
    "dead_time_error": (-100e-6, 100e-6),
}
"""Ranges of uniformly distributed parameters of plates, in SI units and degC. tau (and so Q) and
gain are relative to the model; the neighbouring mode is as often below as above. [A], as for
fingers."""
LIFT_PERIOD, LIFT_LENGTH, LIFT_RAMP = 1.0, 0.1, 0.01
"""Period, length and ramps at both ends, in s, with which a finger lifts."""
_FINGER_STREAM: Final = 0x46
_PLATE_STREAM: Final = 0x50
F0: Final = 43390.0
"""Frequency in Hz at which the fingers are vibrated."""
TRAVEL: Final = 30e-3
"""Distance of the turning points in m; at 150 mm/s, 80 ms remain after the boundary."""
W_LEAST, W_MOST = 0.25e-6, 2.5e-6
"""Amplitudes in m between which a map must span `SPAN`, and the references lie."""
SPAN: Final = 0.13
STEP: Final = 0.1
"""Step of the reference at the boundary, in COF."""
_SWEAT, _SWEAT_RATE = 2.0, 0.05
"""Relative rise of mu0 of a sweating finger, and its initial rate per s."""
UNIFORM: Final = {
    "mu0": (0.3, 0.9),
    "rho": (0.15, 0.5),
    "W0": (0.8e-6, 3e-6),
    "p": (1.0, 2.0),
    "load_damping": (5.0, 14.0),
    "exponent": (0.7, 1.0),
    "stribeck": (1.0, 1.2),
    "speed": (0.03, 0.1),
    "force": (0.3, 0.9),
}
"""Ranges of uniformly distributed parameters, in SI units."""
_LOGARITHMIC: Final = {
    "skin_stiffness": (500.0, 2000.0),
    "skin_damping": (0.5, 2.0),
    "relaxation_length": (5e-6, 40e-6),
    "skin_mass": (0.05e-3, 0.2e-3),
}
_LEAST_SHARE: Final = 2.0**-53
"""Least random number that the inverse of the normal distribution accepts."""
_LEAST: Final = {"exponent": 2.0 / 3.0, "stribeck": 1.0}
_MOST: Final = {"exponent": 1.0}
"""Bounds of parameters of a fingertip that a wider range would exceed."""


class Finger(NamedTuple):
    """A finger of a population."""

    subject: Subject
    force: float
    """Mean normal force in N."""
    speed: float
    """Mean sliding speed in m/s."""
    mu_left: float
    mu_right: float
    stroke_seed: int
    noise_seed: int


def lift(time: float) -> float:
    """Return the force at a time in s, as a fraction, of a finger that lifts every second."""
    since = time % LIFT_PERIOD
    return max(1.0 - smooth(since / LIFT_RAMP), smooth((since - LIFT_LENGTH) / LIFT_RAMP))


def draw_finger(seed: int, number: int, case: Case) -> Finger:
    """Draw a finger whose map spans enough, independently of all other fingers.

    Parameters
    ----------
    seed
        Seed of the campaign, 0 or more.
    number
        Number of the finger, 0 or more.
    case
        Ranges and mismatches.
    """
    rng = np.random.default_rng([seed, _FINGER_STREAM, number])
    while True:
        values = _draw(rng, case)
        force, speed = values.pop("force"), values.pop("speed")
        if case.stribeck is not None:
            values["stribeck"] = case.stribeck
        subject = replace(SUBJECTS[1], name=f"finger-{number}", **values)
        if case.sweats:
            subject = replace(subject, occlusion=_SWEAT, occlusion_time=_SWEAT / _SWEAT_RATE)
        most, least = (
            sliding_coefficient(subject, W, speed, force, 0.0, f0=F0) for W in (W_LEAST, W_MOST)
        )
        if most - least >= SPAN:
            break
    mu_left = float(rng.uniform(least, most - STEP))
    stroke_seed, noise_seed = rng.integers(2**32, size=2).tolist()
    return Finger(subject, force, speed, mu_left, mu_left + STEP, stroke_seed, noise_seed)


def draw_plate(seed: int, number: int, plates: str) -> Plate:
    """Draw the plate under a finger, independently of the fingers.

    Parameters
    ----------
    seed, number
        As for `draw_finger`.
    plates
        One of `PLATES`. The laws assume a dead time longer by half of the pick-up's window, with an
        error for a varied plate. They know gain, tau and softening of an identified plate, and
        otherwise those of the model.
    """
    if plates == "model":
        return MODEL_PLATE
    rng = np.random.default_rng([seed, _PLATE_STREAM, number])
    drawn = {name: float(rng.uniform(*bounds)) for name, bounds in PLATE_RANGES.items()}
    sound, side = MODEL_PLATE.resonator, float(rng.choice((-1.0, 1.0)))
    resonator = replace(
        sound,
        softening=drawn["softening"],
        neighbour_share=drawn["neighbour_share"],
        neighbour_offset=side * drawn["neighbour_offset"],
        tau=sound.tau * drawn["tau"],
        gain=sound.gain * drawn["gain"],
    )
    window, error, model = drawn["pickup_window"], drawn["dead_time_error"], MODEL_PLATE.model
    if window < LEAST_WINDOW:
        window = 0.0
    if plates == "identified":
        error = 0.0
        model = replace(
            model, gain=resonator.gain, tau=resonator.tau, softening=resonator.softening
        )
    return Plate(resonator, window, drawn["temperature"], 0.5 * window + error, model)


def stroke_of(finger: Finger, case: Case) -> Stroke:
    """Return the stroke of a finger, without lifting."""
    return Stroke(
        finger.force,
        finger.speed,
        TRAVEL,
        force_variation=case.variation,
        speed_variation=case.variation,
        seed=finger.stroke_seed,
    )


def _draw(rng: np.random.Generator, case: Case) -> dict[str, float]:
    names = (*UNIFORM, *_LOGARITHMIC)
    shares = dict(zip(names, rng.random(len(names)).tolist(), strict=True))
    if case.coupling:
        shares["W0"] = _coupled(shares["load_damping"], shares["W0"], case.coupling)
    wider, values = case.wider, {}
    for name, bounds in UNIFORM.items():
        more = 0.5 * wider * (bounds[1] - bounds[0])
        low = max(bounds[0] - more, _LEAST.get(name, 0.0))
        high = min(bounds[1] + more, _MOST.get(name, inf))
        values[name] = low + (high - low) * shares[name]
    for name, (low, high) in _LOGARITHMIC.items():
        more = 0.5 * wider * log(high / low)
        values[name] = low * exp(-more) * exp((log(high / low) + 2.0 * more) * shares[name])
    return values


def _coupled(by: float, own: float, coupling: float) -> float:
    """Return a uniform number 0..1 that is negatively correlated to another: Gaussian copula."""
    normal = NormalDist()
    first, second = (normal.inv_cdf(max(share, _LEAST_SHARE)) for share in (by, own))
    return normal.cdf(sqrt(1.0 - coupling * coupling) * second - coupling * first)
