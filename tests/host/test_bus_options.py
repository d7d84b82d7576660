"""Frames of udp_multicast stay on this computer unless somebody wants them out."""

import socket
import struct
from pathlib import Path
from typing import Any

import pytest

from smarttac_can.bench.network import TappedNetwork
from smarttac_can.cli.shared import BusChoice, closing_network
from smarttac_can.host.python_can import PythonCanBus, kept_here
from smarttac_can.timing.loop_run import require_quiet

GROUP = {"interface": "udp_multicast", "channel": "239.74.163.3"}


@pytest.fixture(autouse=True)
def configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """python-can's file, not there as yet; nothing else of this user's counts."""
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path / ".canrc"


@pytest.mark.parametrize("channel", ["239.74.163.3", "ff15:7079:7468:6f6e:6465:6d6f:6d63:6173"])
def test_hop_limit_of_multicast_is_0(channel: str) -> None:
    group = {"interface": "udp_multicast", "channel": channel}
    assert kept_here(group) == {**group, "hop_limit": 0}


@pytest.mark.parametrize("hops", [0, 1, "1", 7])
def test_hop_limit_that_is_given_stays(hops: object) -> None:
    assert kept_here({**GROUP, "hop_limit": hops}) == {**GROUP, "hop_limit": hops}


@pytest.mark.parametrize("interface", ["virtual", "socketcan", "pcan"])
def test_options_of_other_interfaces_stay(interface: str) -> None:
    options = {"interface": interface, "channel": "7", "bitrate": 125_000}
    assert kept_here(options) == options


def test_interface_of_the_configuration(configuration: Path) -> None:
    configuration.write_text("[default]\ninterface = udp_multicast\nchannel = 239.74.163.3\n")
    asked = {"interface": None, "channel": None}
    assert kept_here(asked) == {**asked, "hop_limit": 0}


def test_hop_limit_of_the_configuration(configuration: Path) -> None:
    configuration.write_text("[default]\nhop_limit = 3\n")
    assert kept_here(GROUP) == GROUP
    ignoring = {**GROUP, "ignore_config": True}
    assert kept_here(ignoring) == {**ignoring, "hop_limit": 0}


def test_hop_limit_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAN_CONFIG", '{"hop_limit": 2}')
    assert kept_here(GROUP) == GROUP


@pytest.mark.parametrize("name", ["config_context", "context"])
def test_section_of_the_configuration(name: str, configuration: Path) -> None:
    configuration.write_text("[LAB]\ninterface = udp_multicast\nhop_limit = 3\n[default]\n")
    asked = {"interface": None, "channel": "239.74.163.3", name: "LAB"}
    assert kept_here(asked) == asked
    configuration.write_text("[LAB]\ninterface = udp_multicast\n[default]\nhop_limit = 3\n")
    assert kept_here(asked) == asked
    configuration.write_text("[LAB]\ninterface = udp_multicast\n")
    assert kept_here(asked) == {**asked, "hop_limit": 0}


@pytest.fixture
def hops(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How far each bus of udp_multicast lets its packets go, as its socket was told."""
    told: list[int] = []
    setsockopt = socket.socket.setsockopt

    def listen(self: socket.socket, level: int, option: int, *value: Any) -> None:
        if (level, option) == (socket.IPPROTO_IP, socket.IP_MULTICAST_TTL):
            told.extend(struct.unpack("@I", value[0]))
        setsockopt(self, level, option, *value)

    class Listening(socket.socket):
        setsockopt = listen

    monkeypatch.setattr(socket, "socket", Listening)
    return told


def test_nobody_of_us_sends_out_of_this_computer(
    hops: list[int], multicast: dict[str, Any]
) -> None:
    PythonCanBus(**multicast).close()
    network = TappedNetwork().connect(**multicast)
    network.second_bus().shutdown()
    network.disconnect()
    own = ("interface", "channel")
    others = {key: value for key, value in multicast.items() if key not in own}
    with closing_network(BusChoice(*(multicast[key] for key in own), None, others)):
        pass
    require_quiet(multicast)
    assert hops == [0] * 5


def test_who_wants_out_gets_out(hops: list[int], multicast: dict[str, Any]) -> None:
    PythonCanBus(**multicast, hop_limit=1).close()
    assert hops == [1]
