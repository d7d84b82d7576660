"""The pictures of the report, with what stands below each. Drawing needs matplotlib."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from smarttac_can.bench.traces import Trace
from smarttac_can.population.steps import UndefinedError

CAPTIONS = {
    "fig2": "Friction that a vibration leaves of the friction without one, at five regulated "
    "amplitudes. Points: subjects, set a little aside of each other. Red: their mean.",
    "fig3": "Increment of the vibration amplitude that the friction law asks for at a friction "
    "error E. This is the law itself, not a measurement.",
    "fig5": "Switch-on at the resonance of 30 °C while the plate is at 20 °C, 140 Hz off. Dotted: "
    "where the amplitude enters the 5 % band for good. One point a tick of 1 ms.",
    "fig6": "The voltage behind the runs of Fig. 5, held over each tick. The difference is between "
    "the means over the last 20 ms, in % of the voltage with both loops.",
    "fig7": "Coefficient of friction around the switch of the reference, which follows the "
    "position of the finger. Rise or fall from 10 to 90 % and overshoot are those of the mean "
    "curve, in % of the step between its own levels before the switch and from 40 ms on.",
}


def pictures(
    traces: list[Trace], law: Callable[[float], float], law_name: str
) -> Iterator[tuple[str, dict[str, bytes] | UndefinedError]]:
    """Give the name of each figure and its picture by format, or why there is none.

    Parameters
    ----------
    traces
        The runs.
    law
        Eq. (9) for Fig. 3: E in % to dW in m.
    law_name
        Name of the friction law of the runs.
    """
    from smarttac_can.bench.drawing import rendered  # noqa: PLC0415  matplotlib is an extra
    from smarttac_can.paper import figures  # noqa: PLC0415

    draw: dict[str, Callable[[], Any]] = {
        "fig2": lambda: figures.fig2(traces),
        "fig3": lambda: figures.fig3(law),
        "fig5": lambda: figures.fig5(traces),
        "fig6": lambda: figures.fig6(traces),
        "fig7": lambda: figures.fig7(traces, law_name),
    }
    for name, figure in draw.items():
        try:
            yield name, rendered(figure())
        except UndefinedError as reason:
            yield name, reason
