"""What a person types at a watch that drives."""

import pytest

from smarttac_can.bench import BenchError, Stimulator
from smarttac_can.watch.screen import HINT, obey


def test_set_points_take_units_as_at_the_bench() -> None:
    with Stimulator.simulate("local") as bench:
        for text in ("boundary 5000 um", "voltage 0.02 kV", "amplitude 1.5", "cof 30% 0.4"):
            assert obey(bench, text) == f"done: {text}"
        assert (bench.boundary, bench.voltage, bench.amplitude) == pytest.approx((5, 20, 1.5))
        assert bench.cof == pytest.approx((0.3, 0.4))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("cof", "'cof' is not of the form: cof C [C]"),
        ("cof 1 2 3", "'cof 1 2 3' is not of the form: cof C [C]"),
        ("mode", "'mode' is not of the form: mode NAME"),
        ("voltage", "'voltage' is not of the form: voltage V"),
        ("reset now", "'reset now' is not of the form: reset"),
        ("stop", f"'stop' is none of: {HINT}"),
        ("voltage 5 mm", "Setpoint.Voltage '5 mm' is no number with a unit like V"),
        ("cof x", "cof 'x' is no number or percentage"),
        ("frequency inf", "Setpoint.Frequency inf is not a finite number"),
        ("mode texture", "cannot play: texture slot 1 is empty: a script sets bench.texture first"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(text: str, reason: str) -> None:
    with Stimulator.simulate("local") as bench:
        with pytest.raises((ValueError, BenchError)) as refusal:
            obey(bench, text)
        assert str(refusal.value) == reason
