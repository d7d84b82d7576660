"""Calibration of a tribometer: weighing, and a least-squares fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import hypot, sqrt
from typing import Any, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.plate_loads import STANDARD_GRAVITY, Placing, Weighing
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.bench.traces import Floats
from smarttac_can.science.control.budget import (
    COVERAGE,
    RELATIVE_OF_FOUR,
    Gauges,
    budget,
    combined,
    stated,
)
from smarttac_can.vocabulary.signals import KNOWN_WINDOW_MN

LATERAL: Final = ("Fx from S1", "Fx from S2", "Fy from S1", "Fy from S2")
POSITIONS: Final = ("Position of S3", "Position of S4", "Position of S5", "Position of S6")
RESIDUAL_SHARE: Final = 0.01
"""Largest accepted root mean square of the force residuals, as a fraction of the heaviest
weight."""
RESIDUAL_MM: Final = 1.0
SCALE_SHARE: Final = 0.02
"""Largest relative deviation of S3 to S6 together from the weights; no object corrects it."""
_INDEPENDENT: Final = 0.1
"""Least ratio of the singular values of lateral loads that have two directions."""
GAUGES: Final = range(1, 7)
SAMPLES: Final = 64
BUDGET_COF: Final = 0.5
"""COF for which a certificate has the budget of its uncertainty."""
BUDGET_FORCES: Final = (0.2, 0.5, 1.0, 2.0)
"""Normal forces of that budget in N."""
BUDGET_TEMPERATURES: Final = (20.0, 35.0)
"""Plate temperatures of that budget in degC."""


class Calibration(NamedTuple):
    """Calibration of a tribometer from weighings; values that these do not determine are None."""

    lateral: tuple[float, ...] | None
    """Matrix in ``(Fx, Fy) = lateral (S1, S2)``, by rows."""
    lateral_uncertainty: tuple[float, ...] | None
    """Standard uncertainty of each element; None if there are too few weighings."""
    positions_mm: tuple[float, ...] | None
    """Positions of S3..S6 along x in mm."""
    scale: float
    """Sum of S3 to S6, as a fraction of the weights' normal force."""
    residuals: Floats
    """Shape (n, 4): Fx, Fy and Fn in N and x in mm, fitted minus actual; NaN if not determined, or
    0 by construction as the fit has as many unknowns as weighings."""
    heaviest: float
    """Heaviest weight in N."""

    @classmethod
    def fit(
        cls,
        weighings: Sequence[Weighing],
        positions_mm: Sequence[float],
        gravity: float = STANDARD_GRAVITY,
    ) -> Self:
        """Fit the calibration.

        Lateral loads come from the tilted weighings. Positions come from the level ones, because on
        a tilted plate the height of a weight moves its centre of pressure. A rigid plate can load
        its four gauges in only three ways, so the positions are changed by the least that explains
        the weighings.

        Parameters
        ----------
        weighings
            One or more weighings.
        positions_mm
            Positions of S3..S6 before the fit.
        gravity
            Gravity in m/s^2 at the place of the weighings.

        Raises
        ------
        ValueError
            If there are no weighings, or the tilted ones do not load two directions.
        """
        if not weighings:
            raise ValueError("no weighing to fit a calibration to")
        loads = np.array([weighing.placing.load(gravity) for weighing in weighings])
        gauges = np.array([weighing.gauges for weighing in weighings])
        require_two_directions([weighing.placing for weighing in weighings])
        level = np.array([weighing.placing.level for weighing in weighings])
        x_mm = np.array([weighing.placing.x_mm for weighing in weighings])
        normal = gauges[:, 2:].sum(axis=1)
        residuals = np.full((len(weighings), 4), np.nan)
        residuals[:, 2] = normal - loads[:, 2]
        lateral = uncertainty = positions = None
        if not level.all():
            lateral, uncertainty = _fit_lateral(gauges[~level, :2], loads[~level, :2])
            residuals[:, :2] = gauges[:, :2] @ np.reshape(lateral, (2, 2)).T - loads[:, :2]
            if uncertainty is None:
                residuals[~level, :2] = np.nan
        if level.any():
            moments = loads[level, 2] * x_mm[level]
            positions, spare = _fit_positions(gauges[level, 2:], moments, positions_mm)
            if spare:
                shown = (gauges[level, 2:] @ positions) / loads[level, 2]
                residuals[level, 3] = shown - x_mm[level]
        return cls(
            lateral=lateral,
            lateral_uncertainty=uncertainty,
            positions_mm=positions,
            scale=float(normal @ loads[:, 2] / (loads[:, 2] @ loads[:, 2])),
            residuals=residuals,
            heaviest=float(np.linalg.norm(loads, axis=1).max()),
        )

    @property
    def rms(self) -> tuple[float, ...]:
        """Root mean square of the residuals: Fx, Fy, Fn in N, x in mm; NaN if not determined."""
        columns = [column[~np.isnan(column)] for column in self.residuals.T]
        return tuple(float(np.sqrt(np.mean(c * c))) if len(c) else np.nan for c in columns)

    def shortcomings(self) -> list[str]:
        """Return why the calibration is unusable, a line per reason; empty if it is usable."""
        reasons = []
        *forces, position = self.rms
        for name, rms in zip(("Fx", "Fy", "Fn"), forces, strict=True):
            if rms > RESIDUAL_SHARE * self.heaviest:
                reasons.append(
                    f"{name} is left with {rms * 1e3:.1f} mN rms, above {RESIDUAL_SHARE:.0%} "
                    f"of the heaviest weight of {self.heaviest:.3f} N"
                )
        if position > RESIDUAL_MM:
            reasons.append(f"x is left with {position:.2f} mm rms, above {RESIDUAL_MM:g} mm")
        if abs(self.scale - 1.0) > SCALE_SHARE:
            reasons.append(
                f"S3 to S6 show {self.scale:.4f} of the weights, outside 1 +- {SCALE_SHARE:g}: "
                "a gauge of the wrong polarity or gain, and no object corrects it"
            )
        return reasons

    def unchecked(self) -> list[str]:
        """Return what no weighing can contradict, a line for each; empty if all is checked."""
        lines = []
        if self.lateral is not None and self.lateral_uncertainty is None:
            lines.append(
                "the lateral matrix is unchecked: it fits any two tilted weighings, so add a third"
            )
        if self.positions_mm is not None and np.isnan(self.rms[3]):
            lines.append(
                "the positions are unchecked: they fit so few level weighings in any case, so add "
                "one at another x_mm"
            )
        return lines

    @property
    def gauges(self) -> Gauges | None:
        """Standard uncertainties of the tribometer with it; None without tilted weighings.

        Noise, repeatability, drift, shift and linearity are those of the data sheet. The
        sensitivities are as certain as the scatter of the fit and the repeatability of so many
        weighings let them be. Nothing corrects the scale of Fn, so its whole deviation counts.
        """
        if self.lateral is None:
            return None
        sheet = Gauges()
        xx, xy, yx, yy = self.lateral_uncertainty or (0.0, 0.0, 0.0, 0.0)
        tilted = int(np.sum(~np.isnan(self.residuals[:, 0])))
        # Half of the tilted weighings load each of the two axes.
        repeated = sheet.repeatability / sqrt(0.5 * tilted)
        scatter = max(xx / abs(self.lateral[0]), yy / abs(self.lateral[3]))
        scale = RELATIVE_OF_FOUR * sheet.repeatability / sqrt(len(self.residuals))
        return sheet._replace(
            sensitivity_t=max(scatter, repeated),
            sensitivity_n=hypot(self.scale - 1.0, scale),
            crosstalk=0.5 * hypot(xy, yx),
        )

    def budget(self, temperature: float) -> list[dict[str, float]]:
        """Return the budget of the COF after a calibration at a temperature in degC.

        A row has the standard uncertainty of a COF of 0.5 by component, the combined one, and the
        expanded one (k = 2), at a normal force and a temperature. There is no row without tilted
        weighings.
        """
        if self.gauges is None:
            return []
        rows = []
        for at in BUDGET_TEMPERATURES:
            for Fn in BUDGET_FORCES:
                parts = budget(self.gauges, BUDGET_COF, Fn, at - temperature)
                total = combined(parts)
                place = {"temperature_degC": at, "Fn_N": Fn, "COF": BUDGET_COF}
                rows.append({**place, **parts, "combined": total, "expanded": COVERAGE * total})
        return rows

    def uncertainty_objects(self, temperature: float) -> dict[str, float]:
        """Return the values of the objects with its uncertainty, by name, in displayed units.

        Parameters
        ----------
        temperature
            Plate temperature of the calibration in degC.
        """
        if self.gauges is None:
            return {}
        said = stated(self.gauges, temperature)
        return {
            "Calibration.COF uncertainty": 1e2 * said.relative,
            "Calibration.COF uncertainty per K": 1e6 * said.shift,
            "Calibration.Null drift": 1e6 * said.drift,
            "Calibration.Temperature": said.temperature,
        }

    def objects(self) -> dict[str, float]:
        """Return the values of the objects that it sets, by name, in their displayed units."""
        values: dict[str, float] = {}
        if self.lateral is not None:
            values |= dict(zip(LATERAL, self.lateral, strict=True))
        if self.positions_mm is not None:
            values |= {
                name: 1e3 * mm for name, mm in zip(POSITIONS, self.positions_mm, strict=True)
            }
        return {f"Calibration.{name}": value for name, value in values.items()}

    def as_json(self) -> dict[str, Any]:
        """Return the calibration for a certificate."""
        fx, fy, fn, x = (None if np.isnan(rms) else rms for rms in self.rms)
        return {
            "objects": self.objects(),
            "lateral_standard_uncertainty": self.lateral_uncertainty,
            "normal_scale": self.scale,
            "residual_rms": {"Fx_N": fx, "Fy_N": fy, "Fn_N": fn, "x_mm": x},
            "residuals": [
                [None if np.isnan(value) else float(value) for value in row]
                for row in self.residuals
            ],
            "shortcomings": self.shortcomings(),
            "unchecked": self.unchecked(),
        }


def write_calibration(
    stimulator: Stimulator, calibration: Calibration, nulls: Floats
) -> dict[str, float]:
    """Write a calibration, its uncertainty, and the nulls with their window: all or nothing.

    Parameters
    ----------
    stimulator
        Stimulator that is neither armed nor running.
    calibration
        Fitted calibration.
    nulls
        Raw S1..S6 in N of the level plate without a weight.

    Returns
    -------
    dict
        Written values by name, in displayed units.

    Raises
    ------
    BenchError
        If the stimulator refuses a value; the ones written before are restored.
    """
    values = calibration.objects()
    values |= calibration.uncertainty_objects(stimulator.get("Plate temperature", "degC"))
    values |= {
        f"Gauge null.Null of S{gauge}": 1e3 * float(null)
        for gauge, null in zip(GAUGES, nulls, strict=True)
    }
    values["Gauge null.Window"] = KNOWN_WINDOW_MN
    values = {name: stimulator.nearest(name, value) for name, value in values.items()}
    stimulator.set_all(values)
    return values


def require_two_directions(placings: Sequence[Placing]) -> None:
    """Refuse tilted placings that load only one direction; accept placings without any tilt.

    Raises
    ------
    ValueError
        If they load only one direction.
    """
    loads = [placing.load(STANDARD_GRAVITY)[:2] for placing in placings if not placing.level]
    if not loads:
        return
    strengths = np.linalg.svd(loads, compute_uv=False)
    if len(strengths) < 2 or strengths[1] < _INDEPENDENT * strengths[0]:  # noqa: PLR2004 - x, y
        raise ValueError("the tilted weighings load one direction only: tilt along x and along y")


def _fit_lateral(
    gauges: Floats, loads: Floats
) -> tuple[tuple[float, ...], tuple[float, ...] | None]:
    solution, _, rank, _ = np.linalg.lstsq(gauges, loads, rcond=1e-6)
    if rank < gauges.shape[1]:
        raise ValueError("S1 and S2 do not distinguish the tilted weighings")
    spare = len(loads) - gauges.shape[1]
    uncertainty = None
    if spare > 0:
        variance = ((gauges @ solution - loads) ** 2).sum(axis=0) / spare
        covariance = np.linalg.inv(gauges.T @ gauges)
        spread = np.sqrt(np.outer(variance, np.diag(covariance)))
        uncertainty = tuple(float(value) for value in spread.ravel())
    return tuple(float(value) for value in solution.T.ravel()), uncertainty


def _fit_positions(
    gauges: Floats, moments: Floats, before: Sequence[float]
) -> tuple[tuple[float, ...], int]:
    """Return the positions, and how many weighings there are more than they need."""
    present = np.array(before, dtype=np.float64)
    change, _, rank, _ = np.linalg.lstsq(gauges, moments - gauges @ present, rcond=1e-2)
    return tuple(float(value) for value in present + change), len(gauges) - int(rank)


def weigh(stimulator: Stimulator, placing: Placing, do: Callable[[Placing], object]) -> Weighing:
    """Weigh one weight: measure the gauges without it and with it, at the same tilt.

    Parameters
    ----------
    stimulator
        Connected stimulator that is neither armed nor running.
    placing
        Place of the weight.
    do
        Function that returns once a `Placing` has been made at the plate: a question to a person
        with its text, or ``stimulator.finger.put`` for a simulated plate.

    Raises
    ------
    BenchError
        As `Stimulator.sample`.
    """
    do(placing.empty)
    empty = mean_gauges(stimulator)
    do(placing)
    return Weighing(placing, empty, mean_gauges(stimulator))


def mean_gauges(stimulator: Stimulator) -> npt.NDArray[np.float64]:
    """Return the mean of 64 raw samples of S1..S6 in N, shape (6,)."""
    means: npt.NDArray[np.float64] = stimulator.sample(gauge_names(), SAMPLES).mean(axis=0) * 1e-3
    return means


def gauge_names() -> list[str]:
    """Return the names of the objects with the raw readings of S1..S6."""
    return [f"Plate input.S{gauge}" for gauge in GAUGES]
