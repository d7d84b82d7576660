"""Subjects: parameters of a fingertip, and five presets."""

from __future__ import annotations

from dataclasses import dataclass

from smarttac_can.science.plant.parameters import require

FORCE_REFERENCE = 0.5
"""Normal force in N at which mu0 and the load on the plate are given."""

BOUNDS = {
    "mu0": (0.05, 3.0),
    "exponent": (2.0 / 3.0, 1.0),
    "occlusion": (0.0, 2.0),
    "occlusion_time": (0.1, 1e4),
    "rho": (0.0, 0.95),
    "W0": (0.1e-6, 20e-6),
    "p": (0.5, 4.0),
    "stribeck": (1.0, 2.0),
    "stribeck_speed": (1e-4, 1.0),
    "relaxation_length": (1e-7, 1e-3),
    "skin_mass": (0.0, 1e-2),
    "skin_stiffness": (10.0, 1e5),
    "skin_damping": (0.01, 100.0),
    "creep_ratio": (0.0, 10.0),
    "creep_time": (1e-4, 10.0),
    "release_time": (1e-4, 10.0),
    "load_damping": (0.0, 100.0),
    "load_stiffness": (0.0, 1e8),
}
"""Bounds of the numbers of a subject, in SI units."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """A fingertip.

    Raises
    ------
    ValueError
        A parameter is outside its range.
    """

    name: str
    mu0: float
    """COF at 0.5 N without vibration and occlusion (fitted to the paper's ranges)."""
    exponent: float
    """n of Ft ~ Fn^n, 2/3..1 [L, doi:10.1007/978-3-662-44193-0_15]."""
    occlusion: float
    """Rise of mu0 at full occlusion, as a fraction [A]; on smooth plates up to 9 was measured."""
    occlusion_time: float
    """Time constant of occlusion in s, about 20 s [L, doi:10.1007/978-3-662-44193-0_15]."""
    rho: float
    """Fraction of mu0 that vibration cannot remove [A, fitted]."""
    W0: float
    """Effective vibration in m that removes 1 - 1/e of the removable fraction [A, fitted]."""
    p: float
    """Shape of the friction map, 1..2 [A]."""
    stribeck: float
    """Ratio of the friction at rest to that at high speed, 1.1..1.5 [A]."""
    stribeck_speed: float
    """Speed in m/s at which half of the Stribeck rise has vanished [A]."""
    relaxation_length: float
    """Sliding distance in m over which friction builds up to 1 - 1/e, 11.5 um
    [D from L, arXiv:2505.11162]."""
    skin_mass: float
    """Moving mass of the skin in kg [A]."""
    skin_stiffness: float
    """Lateral stiffness of the skin in N/m [A]."""
    skin_damping: float
    """Lateral damping of the skin in N s/m [A]."""
    creep_ratio: float
    """Ratio of the stretch that follows a force slowly to that of the stiffness [A]."""
    creep_time: float
    """Time constant in s of that slow part [A]: a held stretch that lower friction releases is gone
    after the 20 ms of [L, doi:10.1098/rsif.2022.0718]."""
    release_time: float
    """Time constant in s with which a contact loses force that friction does not hold [A]."""
    load_damping: float
    """Damping that the finger adds to the mode at 0.5 N, in N s/m [A]."""
    load_stiffness: float
    """Stiffness that the finger adds to the mode at 0.5 N, in N/m [A]."""

    def __post_init__(self) -> None:
        for name, (low, high) in BOUNDS.items():
            require(name, getattr(self, name), low, high)


def _preset(name: str, mu0: float, rho: float, W0: float, p: float, load_damping: float) -> Subject:
    return Subject(
        name=name,
        mu0=mu0,
        exponent=0.9,
        occlusion=0.05,
        occlusion_time=20.0,
        rho=rho,
        W0=W0,
        p=p,
        stribeck=1.1,
        stribeck_speed=30e-3,
        relaxation_length=11.5e-6,
        skin_mass=1e-4,
        skin_stiffness=1e3,
        skin_damping=1.0,
        creep_ratio=0.5,
        creep_time=7e-3,
        release_time=20e-3,
        load_damping=load_damping,
        load_stiffness=1.5e5,
    )


SUBJECTS: tuple[Subject, ...] = (
    _preset("dry", 0.33, 0.22, 1.8e-6, 1.3, 11.0),
    _preset("fair", 0.445, 0.25, 2.3e-6, 1.35, 8.0),
    _preset("supple", 0.555, 0.28, 2.4e-6, 1.4, 7.5),
    _preset("moist", 0.652, 0.45, 2.0e-6, 1.2, 10.5),
    _preset("sticky", 0.85, 0.15, 1.3e-6, 1.6, 9.0),
)
"""The five subjects of Fig. 2; the first four are those of Table I, in its order."""
