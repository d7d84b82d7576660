"""What may differ from what the laws were tuned for: the cases of a campaign."""

from __future__ import annotations

from typing import Final, NamedTuple


class Case(NamedTuple):
    """A mismatch, and how large."""

    path_frequency: float = 1.0
    """Factor of the force path's natural frequency."""
    path_damping: float | None = None
    """Damping ratio of the force path; None for that of the plate."""
    slope: float = 1.0
    """Factor of the friction law's step per % of error."""
    variation: float = 0.2
    """Half-width of force and speed from pass to pass, as a fraction."""
    stribeck: float | None = None
    """Stribeck ratio of all fingers; None for one at random."""
    lifts: bool = False
    """Whether the finger lifts each second, for 0.1 s."""
    sweats: bool = False
    """Whether mu0 rises by 5 % a second at first, on the way to three times."""
    film_lag: float = 0.0
    """Time constant of the squeeze film in s."""
    ripple: float = 0.0
    """Swing of the amplitude under a moving finger, as a fraction."""
    wider: float = 0.0
    """How much wider the ranges of the fingers are, as a fraction."""


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
}
"""The cases by name."""
