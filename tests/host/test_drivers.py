"""A missing driver is named with its cure, and an installed one is not."""

import errno
from importlib import util

import can
import pytest

from smarttac_can.canopen.bus.bus import BusError
from smarttac_can.host import python_can
from smarttac_can.host.drivers import cure, unknown_options
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
    assert cure(interface, OSError()) == f"; it needs a package: pip install '{pip}'"


@pytest.mark.parametrize("interface", ["udp_multicast", "virtual", "socketcan", None])
def test_driver_with_its_package_gets_no_hint(interface: str | None) -> None:
    assert util.find_spec("msgpack") is not None, "of udp_multicast"
    assert cure(interface, OSError()) == ""


def test_driver_that_cannot_be_opened_names_its_library() -> None:
    with pytest.raises(BusError, match=r"^cannot open the kvaser bus, channel 0: .*CANlib"):
        PythonCanBus("kvaser", "0")


@pytest.mark.parametrize(
    ("interface", "known"),
    [
        ("virtual", ["rx_queue_size", "receive_own_messages", "can_filters"]),
        ("udp_multicast", ["port", "hop_limit", "fd"]),
        ("socketcan", ["local_loopback", "receive_own_messages"]),
        ("kvaser", ["single_handle", "tseg1"]),
        ("no such interface", ["nonsense"]),
        (None, ["nonsense"]),
    ],
)
def test_options_that_an_interface_has_are_not_named(
    interface: str | None, known: list[str]
) -> None:
    assert unknown_options(interface, known) == []


@pytest.mark.parametrize(
    ("interface", "some", "near"),
    [
        ("virtual", "preserve_timestamps, protocol, rec", "; perhaps 'protocol'"),
        ("udp_multicast", "fd, hop_limit, port, rec", "; perhaps 'port'"),
        ("socketcan", "local_loopback, receive_own_messages", "; it has such as "),
    ],
)
def test_options_that_it_would_swallow_are(interface: str, some: str, near: str) -> None:
    nonsense, prot = unknown_options(interface, ["nonsense", "channel", "prot"])
    assert nonsense.startswith(f"{interface} has no option 'nonsense'; it has such as can_filters")
    assert some in nonsense
    assert prot.startswith(f"{interface} has no option 'prot'{near}")


def test_driver_name_inside_code_is_suggested() -> None:
    (line,) = unknown_options("kvaser", ["recieve_own_messages"])
    assert line == "kvaser has no option 'recieve_own_messages'; perhaps 'receive_own_messages'"


def test_unknown_interface_lists_similar_ones_or_all() -> None:
    with pytest.raises(BusError) as misspelt:
        PythonCanBus("scoketcan", "can0")
    assert str(misspelt.value).endswith("; perhaps 'socketcan'")
    with pytest.raises(BusError) as unknown:
        PythonCanBus("carrier_pigeon", "can0")
    assert "; there are canalystii, cantact, etas, " in str(unknown.value)
    assert str(unknown.value).endswith(", vector, virtual")


NO_ROUTE = "; no route to the group: ip link set lo up; for IPv4 ip route add 239.0.0.0/8 dev lo"
GROUP = ("udp_multicast", "239.74.163.2", "")
NO_CHANNEL = "which has no channel: could not create socket"


@pytest.mark.parametrize(
    ("bus", "number", "said"),
    [
        (GROUP, errno.ENODEV, f"create socket{NO_ROUTE}"),
        (GROUP, errno.ENETUNREACH, f"create socket{NO_ROUTE}"),
        (GROUP, errno.EACCES, "create socket"),
        (
            ("udp_multicast", None, ""),
            errno.ENODEV,
            f"{NO_CHANNEL}; name the group as the channel, such as --channel 239.74.163.2",
        ),
        (
            ("udp_multicast", None, "ff15::7"),
            errno.EAFNOSUPPORT,
            "channel ff15::7 of python-can's configuration: could not create socket",
        ),
        (
            ("socketcan", None, ""),
            errno.EAFNOSUPPORT,
            f"{NO_CHANNEL}; this kernel has no SocketCAN; udp_multicast needs none, and "
            "tools/with-vcan has its own",
        ),
        (
            ("socketcan", "can0", ""),
            errno.ENODEV,
            "; there is no such interface; ip link lists those there are",
        ),
        (("socketcan", "can0", ""), errno.EACCES, "create socket"),
    ],
)
def test_a_bus_that_cannot_be_opened_has_its_cure(
    bus: tuple[str, str | None, str], number: int, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(**_options: object) -> None:
        raise can.CanInitializationError("could not create socket") from OSError(number, "no")

    interface, channel, configured = bus
    monkeypatch.setattr(can, "Bus", refuse)
    monkeypatch.setattr(python_can, "MulticastBus", refuse)
    monkeypatch.setattr(can, "rc", {"channel": configured} if configured else {})
    with pytest.raises(BusError) as refusal:
        PythonCanBus(interface, channel)
    assert str(refusal.value).startswith(f"cannot open the {interface} bus, ")
    assert str(refusal.value).endswith(said)


def test_a_configuration_that_is_wrong_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAN_CONFIG", "{")
    with pytest.raises(BusError, match=r"^cannot open the udp_multicast bus, which has no channel"):
        PythonCanBus("udp_multicast")


def test_a_channel_that_is_no_group_has_its_cure() -> None:
    with pytest.raises(
        BusError, match=r"; the channel has to be a group, such as 239\.74\.163\.2$"
    ):
        PythonCanBus("udp_multicast", "9.74.163.2")
