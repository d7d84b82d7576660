import pytest
from one_device import download, play, started

from smarttac_can.device.error_behaviour import ErrorClass
from smarttac_can.device.nmt import NMTState

STATES = {0: NMTState.PRE_OPERATIONAL, 1: NMTState.OPERATIONAL, 2: NMTState.STOPPED}


@pytest.mark.parametrize("behaviour", STATES)
@pytest.mark.parametrize("error_class", ErrorClass)
def test_each_class_has_its_own(error_class: ErrorClass, behaviour: int) -> None:
    device = started()
    other = 4 - error_class
    assert download(device, 0x1029, error_class, behaviour, 1) == 0
    assert download(device, 0x1029, other, 1, 1) == 0
    device.react(ErrorClass(other))
    assert device.nmt_state is NMTState.OPERATIONAL
    device.react(error_class)
    assert device.nmt_state is STATES[behaviour]


def test_reserved_values() -> None:
    device = started()
    assert download(device, 0x1029, 1, 3, 1) == 0x06090031


def test_bus_off() -> None:
    device = started()
    assert device.bus_off() == []
    assert device.nmt_state is NMTState.PRE_OPERATIONAL
    sent = device.bus_recovered()
    assert [f.data.hex(" ") for f in sent] == ["40 81 11 00 00 00 00 00", "00 00 00 00 00 00 00 00"]
    play(device, "> 620 40 03 10 01 00 00 00 00\n< 5A0 43 03 10 01 40 81 00 00")


def test_stopped_stays_stopped() -> None:
    device = started()
    play(device, "> 000 02 20")
    device.bus_off()
    assert device.nmt_state is NMTState.STOPPED
