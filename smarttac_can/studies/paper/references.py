"""The figures published in the paper, their places, and the bands by which results are judged.

Source of all: "High fidelity closed loop controlled friction in SMARTTAC tactile stimulator".
A figure without a band is shown beside the result and not judged: four people are not four
presets of a simulation, and only their mean and spread show what the control does.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

TITLE = "High fidelity closed loop controlled friction in SMARTTAC tactile stimulator"


Origin = Literal["fitted", "chosen", "emerges"]


class Published(NamedTuple):
    """A published figure and the band for a result."""

    key: str
    """Key of the result in the summary, such as ``table1.subjects[0].rise_time_ms``."""
    name: str
    """Name in words."""
    value: float | None
    """Figure in the paper; None if the paper has only words."""
    unit: str
    where: str
    """Place in the paper."""
    low: float | None = None
    """Lower bound of the band, included; None if not judged."""
    high: float | None = None
    """Upper bound of the band, included; None if not judged."""
    origin: Origin = "emerges"
    """How far a result can agree by design: ``fitted`` if parameters were computed from this
    figure, or searched for with it as the aim; ``chosen`` if a design choice was made from a range
    in which the figure results, and the result then checked; else ``emerges``."""


AMPLITUDE_UM = 1.0
"""Amplitude set-point of Fig. 5 and 6 in um peak-to-peak."""
STEP_UM = 1.5
"""Amplitude in um of the step by 50 % that follows Fig. 5 under a finger; not in the paper."""
RESPONSE_BAND = 0.05
"""Band of the response time of Fig. 5: 5 %."""
FREQUENCY_20_DEGC = 43_390.0
"""Resonance in Hz at 20 degC: that of the plate in Fig. 5 and 6."""
REFERENCES = ((0.2, 0.3), (0.3, 0.4), (0.4, 0.5), (0.5, 0.6))
"""Lower and upper COF reference of subjects 1 to 4 in Fig. 7."""
RISE_TIMES_MS = (3.37, 3.41, 2.87, 5.72)
OVERSHOOTS_PERCENT = (27.6, 44.4, 48.0, 30.0)
RISE_TIME_MS = (3.84, 1.27)
"""Mean and sample standard deviation over the four subjects."""
OVERSHOOT_PERCENT = (37.5, 10.2)
"""Mean and sample standard deviation over the four subjects."""


def _subject_rows() -> list[Published]:
    rows = []
    for i, (rise, overshoot) in enumerate(zip(RISE_TIMES_MS, OVERSHOOTS_PERCENT, strict=True)):
        key, name = f"table1.subjects[{i}]", f"subject {i + 1}"
        rows += [
            Published(
                f"{key}.rise_time_ms", f"Rise time, {name}", rise, "ms", "Table I", origin="fitted"
            ),
            Published(
                f"{key}.overshoot_percent",
                f"Overshoot, {name}",
                *(overshoot, "%", "Table I"),
                origin="fitted",
            ),
        ]
    return rows


def _mean_and_spread(mean_and_std: tuple[float, float]) -> tuple[float, float]:
    mean, std = mean_and_std
    return round(mean - std, 2), round(mean + std, 2)


PUBLISHED: tuple[Published, ...] = (
    Published(
        "fig5.amplitude_and_frequency.response_time_ms",
        "5 % response time, both loops",
        *(2.0, "ms", "text on Fig. 5", 1.4, 2.6),
        origin="chosen",
    ),
    Published(
        "fig5.amplitude_only.response_time_ms",
        "5 % response time, amplitude loop alone",
        *(5.0, "ms", "text on Fig. 5", 4.0, 6.0),
        origin="chosen",
    ),
    Published(
        "fig5.amplitude_and_frequency.steady_amplitude_um",
        "Steady amplitude, both loops",
        *(AMPLITUDE_UM, "um", "text on Fig. 5", 0.98, 1.02),
    ),
    Published(
        "fig5.amplitude_only.steady_amplitude_um",
        "Steady amplitude, amplitude loop alone",
        *(AMPLITUDE_UM, "um", "text on Fig. 5", 0.98, 1.02),
    ),
    Published(
        "fig5.amplitude_and_frequency.final_frequency_hz",
        "Frequency reached by both loops",
        *(FREQUENCY_20_DEGC, "Hz", "text on Fig. 5", 43_388.0, 43_392.0),
    ),
    Published(
        "fig6.voltage_difference_percent",
        "More voltage off resonance",
        *(30.0, "%", "text on Fig. 6", 28.0, 32.0),
        origin="fitted",
    ),
    Published(
        "table1.mean.rise_time_ms",
        "Rise time, mean of four subjects",
        *(RISE_TIME_MS[0], "ms", "Table I", *_mean_and_spread(RISE_TIME_MS)),
        origin="fitted",
    ),
    Published(
        "table1.mean.overshoot_percent",
        "Overshoot, mean of four subjects",
        *(OVERSHOOT_PERCENT[0], "%", "Table I", *_mean_and_spread(OVERSHOOT_PERCENT)),
        origin="fitted",
    ),
    Published(
        "table1.mean.static_error_percent",
        "Static error, mean of four subjects",
        *(None, "%", 'text on Fig. 7: "works well in static regime"', 0.0, 5.0),
    ),
    Published(
        "table1.std.rise_time_ms",
        "Rise time, spread over subjects",
        *(RISE_TIME_MS[1], "ms", "text on Table I"),
        origin="fitted",
    ),
    Published(
        "table1.std.overshoot_percent",
        "Overshoot, spread over subjects",
        *(OVERSHOOT_PERCENT[1], "%", "text on Table I"),
        origin="fitted",
    ),
    *_subject_rows(),
)
"""All figures with which results are compared, in the order of the paper."""


def published(key: str) -> str:
    """Return the paper's number as a text to follow a result; empty if there is none.

    Parameters
    ----------
    key
        Key of the result in the summary.
    """
    values = [row.value for row in PUBLISHED if row.key == key and row.value is not None]
    return f" (paper {values[0]:g})" if values else ""
