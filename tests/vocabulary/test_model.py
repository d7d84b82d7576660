"""The model of the plate: its ranges, and the load of a finger."""

import cmath
import math

import pytest

from smarttac_can.vocabulary.model import PlateModel, contact_load

MODEL = PlateModel(gain=50e-9, tau=1e-3, f0=43390.0, load=0.8)


@pytest.mark.parametrize(
    ("Fn", "contact"), [(0.5, 1.0), (4.0, 4.0), (0.0625, 0.25), (0.0, 0.0), (-0.3, 0.0)]
)
def test_a_contact_grows_with_two_thirds_of_the_force(Fn: float, contact: float) -> None:
    assert contact_load(Fn) == pytest.approx(contact)


@pytest.mark.parametrize(("contact", "rate"), [(0.0, 1000.0), (1.0, 1800.0), (2.0, 2600.0)])
def test_a_finger_adds_to_the_decay(contact: float, rate: float) -> None:
    assert MODEL.decay_rate(contact) == pytest.approx(rate)


@pytest.mark.parametrize("detuning", [0.0, 140.0, -90.0])
@pytest.mark.parametrize("Fn", [0.1, 0.5, 1.3])
def test_one_press_tells_the_load(Fn: float, detuning: float) -> None:
    rate = 1000.0 * (1.0 + 0.8 * (Fn / 0.5) ** (2 / 3))
    W = 50e-9 / 1e-3 * 30.0 / complex(rate, 2 * math.pi * detuning)
    assert MODEL.load_of_press(30.0, W, Fn) == pytest.approx(0.8)
    # W is seen in the frame of the voltage: a turn with the frame would be an error.
    assert MODEL.load_of_press(30.0, W * cmath.rect(1.0, 0.3), Fn) != pytest.approx(0.8)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"gain": 0.0}, r"gain 0 is outside 1e-09\.\.1e-06"),
        ({"gain": -50e-9}, r"gain -5e-08 is outside 1e-09\.\.1e-06"),
        ({"tau": 0.0}, r"tau 0 is outside 0\.0001\.\.0\.01"),
        ({"tau": math.nan}, r"tau nan is outside 0\.0001\.\.0\.01"),
        ({"f0": math.inf}, r"f0 inf is outside 1000\.\.1e\+06"),
        ({"load": 5.1}, r"load 5\.1 is outside 0\.\.5"),
        ({"load": math.nan}, r"load nan is outside 0\.\.5"),
        ({"temperature": -41.0}, r"temperature -41 is outside -40\.\.125"),
    ],
)
def test_a_model_is_checked(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        PlateModel(**wrong)


def test_quality() -> None:
    assert PlateModel(50e-9, 0.944e-3, 43390.0).quality == pytest.approx(128.7, abs=0.05)
