"""Every parameter has a range; at its ends the controllers run, and beyond them it is refused."""

import dataclasses

import pytest
from first_order_plate import FirstOrderPlate, gauges, setpoint
from stated_bounds import made_at_bounds

from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.vocabulary.states import Mode

DEFAULT = CascadeParameters()
NUMBERS = [
    item.name
    for item in dataclasses.fields(CascadeParameters)
    if isinstance(getattr(DEFAULT, item.name), float)
]
PLACES = range(4)


def runs(parameters):
    cascade, plate = Cascade(parameters), FirstOrderPlate()
    for mode in (Mode.AMPLITUDE_RESONANCE, Mode.FRICTION):
        cascade.set_mode(mode)
        for _ in range(5):
            drive = cascade.update(plate.measure(gauges(Fx=0.2, Fn=0.5)), setpoint())
            assert 0.0 <= drive.voltage <= parameters.V_max
            assert parameters.f_min <= drive.frequency <= parameters.f_max
            plate.step(drive)
        assert cascade.mode is mode


def put(values, at, value):
    return (*values[:at], value, *values[at + 1 :])


MAKES = {
    **{name: [lambda value, n=name: CascadeParameters(**{n: value})] for name in NUMBERS},
    "f_min": [lambda value: CascadeParameters(f_min=value, f_max=1e6)],
    "gauge_positions": [
        lambda value, at=at: CascadeParameters(
            gauge_positions=put(DEFAULT.gauge_positions, at, value)
        )
        for at in PLACES
    ],
    "lateral": [
        lambda value, at=at: CascadeParameters(
            lateral=put(DEFAULT.lateral, at // 2, put(DEFAULT.lateral[at // 2], at % 2, value))
        )
        for at in PLACES
    ],
}


@pytest.mark.parametrize("name", MAKES)
def test_controllers_run_at_each_bound_of_a_parameter(name):
    for make in MAKES[name]:
        for parameters in made_at_bounds(name, make):
            runs(parameters)
        runs(DEFAULT)


@pytest.mark.parametrize("name", ["law", "vibration_law"])
def test_a_law_that_there_is_not_is_refused(name):
    with pytest.raises(ValueError, match="99 is not a valid"):
        CascadeParameters(**{name: 99})


def test_the_highest_frequency_is_not_below_the_lowest():
    with pytest.raises(ValueError, match=r"^f_max 43800 is outside 43900\.\.1e\+06$"):
        CascadeParameters(f_min=43900.0, f_max=43800.0)
