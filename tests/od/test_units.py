import pytest

from smarttac_can.od.units import PLAIN, Unit, split_name


@pytest.mark.parametrize(
    ("parameter_name", "name", "unit"),
    [
        ("Voltage [10 mV]", "Voltage", Unit("mV", 10.0, 0.01)),
        ("COF [0.0001]", "COF", Unit("", 0.0001, 0.0001)),
        ("Tau [0.1 us]", "Tau", Unit("us", 0.1, 1e-7)),
        ("Temperature [0.01 degC]", "Temperature", Unit("degC", 0.01, 0.01)),
        ("Amplitude [nm]", "Amplitude", Unit("nm", 1.0, 1e-9)),
        ("Frequency [0.01 Hz]", "Frequency", Unit("Hz", 0.01, 0.01)),
        ("Speed [0.1 mm/s]", "Speed", Unit("mm/s", 0.1, 1e-4)),
        ("Damping [N s/m]", "Damping", Unit("N s/m", 1.0, 1.0)),
        ("Mass [g]", "Mass", Unit("g", 1.0, 1e-3)),
        ("Load [0.1 %]", "Load", Unit("%", 0.1, 1e-3)),
        ("Acceleration [mm/s^2]", "Acceleration", Unit("mm/s^2", 1.0, 1e-3)),
        ("Mode", "Mode", PLAIN),
    ],
)
def test_unit_is_parted_from_the_name(parameter_name: str, name: str, unit: Unit) -> None:
    assert split_name(parameter_name) == (name, unit)


@pytest.mark.parametrize(
    "parameter_name", ["X [reserved]", "X [1]", "X []", "X [0.0 mV]", "X [mmm]"]
)
def test_what_is_no_unit_is_refused(parameter_name: str) -> None:
    with pytest.raises(ValueError, match="is not known"):
        split_name(parameter_name)
