"""What is missing is named with its cure, and nothing is when it is there."""

from importlib import util

import pytest

from smarttac_can.host.bus import BusError
from smarttac_can.host.drivers import cure
from smarttac_can.host.python_can import PythonCanBus


@pytest.mark.parametrize(
    ("interface", "pip"),
    [
        ("slcan", "python-can[serial]"),
        ("gs_usb", "python-can[gs-usb]"),
        ("udp_multicast", "smarttac-can[multicast]"),
    ],
)
def test_a_package_that_is_not_there_is_named_for_pip(
    interface: str, pip: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smarttac_can.host.drivers.find_spec", lambda _module: None)
    assert cure(interface) == f"; it needs a package: pip install '{pip}'"


def test_a_package_that_is_there_is_not_named() -> None:
    assert util.find_spec("msgpack") is not None
    assert cure("udp_multicast") == ""


@pytest.mark.parametrize("interface", ["virtual", "socketcan", "carrier_pigeon", None])
def test_what_needs_nothing_gets_no_hint(interface: str | None) -> None:
    assert cure(interface) == ""


def test_a_driver_that_cannot_be_opened_is_told_with_the_library_of_its_maker() -> None:
    with pytest.raises(BusError, match=r"^cannot open the kvaser bus, channel 0: .*CANlib"):
        PythonCanBus("kvaser", "0")
