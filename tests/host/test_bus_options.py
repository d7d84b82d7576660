"""Frames of udp_multicast stay on this computer unless somebody wants them out."""

import re
import socket
import struct
from pathlib import Path
from typing import Any

import can
import pytest

import smarttac_can
from smarttac_can.assurance.timing.loop_run import require_free
from smarttac_can.bench.network import TappedNetwork
from smarttac_can.cli.shared import BusChoice, closing_network
from smarttac_can.host import python_can
from smarttac_can.host.python_can import PythonCanBus, open_bus

GROUP = {"interface": "udp_multicast", "channel": "239.74.163.3"}


@pytest.fixture(autouse=True)
def configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """python-can's file, not there as yet; nothing else of this user's counts."""
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path / ".canrc"


MULTICAST = "interface = udp_multicast\n"
NEITHER = {"interface": None, "channel": None}
LAB = {"interface": None, "channel": "239.74.163.3"}


@pytest.mark.parametrize(
    ("file", "environment", "given", "hops"),
    [
        ("", "", GROUP, 0),
        ("", "", GROUP | {"channel": "ff15:7079:7468:6f6e:6465:6d6f:6d63:6173"}, 0),
        *(("", "", GROUP | {"hop_limit": hops}, int(hops)) for hops in (0, 1, "1", 7)),
        *(
            ("", "", {"interface": other, "channel": "7", "bitrate": 125_000}, None)
            for other in ("virtual", "socketcan", "pcan")
        ),
        (f"[default]\n{MULTICAST}channel = 239.74.163.3\n", "", NEITHER, 0),
        ("[default]\nhop_limit = 3\n", "", GROUP, 3),
        ("[default]\nhop_limit = 3\n", "", GROUP | {"ignore_config": True}, 0),
        ("", '{"hop_limit": 2}', GROUP, 2),
        *(
            (text, "", LAB | {context: "LAB"}, hops)
            for context in ("config_context", "context")
            for text, hops in (
                (f"[LAB]\n{MULTICAST}hop_limit = 3\n[default]\n", 3),
                (f"[LAB]\n{MULTICAST}[default]\nhop_limit = 3\n", 3),
                (f"[LAB]\n{MULTICAST}", 0),
            )
        ),
    ],
)
def test_multicast_hop_limit_is_0_unless_given(
    file: str,
    environment: str,
    given: dict[str, Any],
    hops: int | None,
    configuration: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if file:
        configuration.write_text(file)
    if environment:
        monkeypatch.setenv("CAN_CONFIG", environment)
    monkeypatch.setattr(python_can, "MulticastBus", lambda **options: options)
    monkeypatch.setattr(can, "Bus", lambda **options: options)
    opened = open_bus(given)
    assert opened.get("hop_limit") == hops
    assert hops is not None or opened == given, "other interfaces are opened by python-can"


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


def test_every_multicast_socket_has_hop_limit_0(hops: list[int], multicast: dict[str, Any]) -> None:
    PythonCanBus(**multicast).close()
    network = TappedNetwork().connect(**multicast)
    network.second_bus().shutdown()
    network.disconnect()
    own = ("interface", "channel")
    others = {key: value for key, value in multicast.items() if key not in own}
    with closing_network(BusChoice(*(multicast[key] for key in own), None, others)):
        pass
    require_free(multicast)
    assert hops == [0] * 5


def test_multicast_hop_limit_1_leaves_the_computer(
    hops: list[int], multicast: dict[str, Any]
) -> None:
    PythonCanBus(**multicast, hop_limit=1).close()
    assert hops == [1]


def test_one_place_of_the_package_opens_buses() -> None:
    package = Path(smarttac_can.__file__).parent
    opening = re.compile(r"(?<!class )\b(can\.Bus|can\.ThreadSafeBus|\w*MulticastBus)\(")
    files = {path.name for path in package.rglob("*.py") if opening.search(path.read_text("utf-8"))}
    assert files == {"python_can.py"}, "else datagrams are decoded by python-can"
