"""The parameters of the cascade, with their ranges."""

from __future__ import annotations

from dataclasses import dataclass

from smarttac_can.science.control.design import POLE_MAX
from smarttac_can.science.control.tribometer import Matrix
from smarttac_can.vocabulary.model import GAIN_MIN, TAU_MIN, require
from smarttac_can.vocabulary.states import Law, VibrationLaw


@dataclass(frozen=True, slots=True)
class CascadeParameters:
    """Parameters that an integrator can set, in SI units.

    Raises
    ------
    ValueError
        A value is out of its range; the message names the first one and its range.
    """

    vibration_law: VibrationLaw = VibrationLaw.PI
    """Law of the amplitude and resonance loops."""
    amplitude_pole: float = 0.2
    """Closed-loop pole of the amplitude loop, 0..0.95; a design choice that gives Fig. 5."""
    resonance_pole: float = 0.3
    """Closed-loop pole of the resonance loop, 0..0.95; a design choice that gives Fig. 5."""
    law: Law = Law.MEASURED
    """Friction law: to what the step of eq. (9) is added, or the friction map."""
    slope: float = 0.04e-6
    """Step of the amplitude in m per % of friction error, 0..1e-6; paper eq. (9)."""
    step_max: float = 1e-6
    """Largest step of the amplitude in m, 0..10e-6; paper eq. (9)."""
    contact_force: float = 0.1
    """Normal force in N above which a finger touches, 0.01..10; an assumption."""
    hysteresis: float = 1e-3
    """Hysteresis in m around the boundary, in which the side does not change, 0..0.05."""
    V_max: float = 150.0
    """Largest voltage in V, 0..500; an assumption."""
    W_max: float = 3e-6
    """Largest amplitude reference in m peak-to-peak, 0..10e-6: the range of the pick-up."""
    f_min: float = 42700.0
    """Lowest excitation frequency in Hz, 1e3..1e6."""
    f_max: float = 44000.0
    """Highest excitation frequency in Hz, f_min..1e6."""
    sheet_gain: float = 50e-9
    """Gain of the plate in its data sheet in m peak-to-peak per V, 1e-9..1e-6; an assumption."""
    sheet_tau: float = 0.944e-3
    """Time constant of the plate in its data sheet in s, 1e-4..1e-2."""
    sheet_tolerance: float = 0.1
    """Largest relative difference of an identified plate from it, 0.01..0.5; an assumption."""
    preview: float = 1.5e-3
    """Time in s by which the reference of a texture is ahead of the finger, 0..0.02: the delay of
    the COF behind its reference, in addition to the dead time."""
    dead_time: float = 0.0
    """Time from the tick until the new drive is in force in s, 0..999e-6, so that it is in the
    tick."""
    lateral: Matrix = ((1.0, 0.0), (0.0, 1.0))
    """Calibration ``(Fx, Fy) = lateral (S1, S2)``, elements -10..10."""
    gauge_positions: tuple[float, float, float, float] = (-28e-3, 28e-3, -28e-3, 28e-3)
    """Positions of S3..S6 along x in m from the middle of the plate, -0.038..0.038."""
    gauge_noise: float = 4.3e-3
    """Standard uncertainty of one gauge in N, 0..1: u(mu) is 0.011 at 0.5 N and mu 0.4."""
    cof_uncertainty: float = 0.0
    """Relative standard uncertainty of the COF by a calibration, 0..1; 0 for noise alone."""
    cof_uncertainty_shift: float = 0.0
    """Relative standard uncertainty of the COF in 1/K away from the calibration, 0..0.1."""
    null_drift: float = 0.0
    """Standard uncertainty of a gauge's null in N/K away from the calibration, 0..1."""
    calibration_temperature: float = 0.0
    """Temperature of the calibration in degC, -40..125."""

    node_distance: float = 8e-3
    """Distance of the nodes of the mode in m, 1e-3..0.1; 8 mm in the data of the plate."""
    shape_cosine: float = 0.0
    """Part of the vibration that acts on a finger by the cosine of its position, -0.4..0.4."""
    shape_sine: float = 0.0
    """Part of it by the sine of its position, -0.4..0.4."""

    def __post_init__(self) -> None:
        VibrationLaw(self.vibration_law)
        require("amplitude_pole", self.amplitude_pole, 0.0, POLE_MAX)
        require("resonance_pole", self.resonance_pole, 0.0, POLE_MAX)
        Law(self.law)
        require("slope", self.slope, 0.0, 1e-6)
        require("step_max", self.step_max, 0.0, 10e-6)
        require("contact_force", self.contact_force, 0.01, 10.0)
        require("hysteresis", self.hysteresis, 0.0, 0.05)
        require("V_max", self.V_max, 0.0, 500.0)
        require("W_max", self.W_max, 0.0, 10e-6)
        require("f_min", self.f_min, 1e3, 1e6)
        require("f_max", self.f_max, self.f_min, 1e6)
        require("sheet_gain", self.sheet_gain, GAIN_MIN, 1e-6)
        require("sheet_tau", self.sheet_tau, TAU_MIN, 1e-2)
        require("sheet_tolerance", self.sheet_tolerance, 0.01, 0.5)
        require("preview", self.preview, 0.0, 20e-3)
        require("dead_time", self.dead_time, 0.0, 999e-6)
        for row in self.lateral:
            for element in row:
                require("lateral", element, -10.0, 10.0)
        require("node_distance", self.node_distance, 1e-3, 0.1)
        require("shape_cosine", self.shape_cosine, -0.4, 0.4)
        require("shape_sine", self.shape_sine, -0.4, 0.4)
        for x in self.gauge_positions:
            require("gauge_positions", x, -0.038, 0.038)
        require("gauge_noise", self.gauge_noise, 0.0, 1.0)
        require("cof_uncertainty", self.cof_uncertainty, 0.0, 1.0)
        require("cof_uncertainty_shift", self.cof_uncertainty_shift, 0.0, 0.1)
        require("null_drift", self.null_drift, 0.0, 1.0)
        require("calibration_temperature", self.calibration_temperature, -40.0, 125.0)

    def clip_frequency(self, frequency: float) -> float:
        """Return a frequency in Hz, cut to the limits."""
        return min(max(frequency, self.f_min), self.f_max)
