"""A network knows its bus by any configuration of python-can, and ignores other frames."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from queue import Queue
from typing import Any

import can
import pytest
from nodes_on_a_bus import GUARD_S

from smarttac_can.bench.network import TappedNetwork


def echoes(**options: Any) -> tuple[bool, bool]:
    """The text of the network, and the bus as python-can has opened it."""
    network = TappedNetwork()
    network.NOTIFIER_CYCLE = 0.01  # for which disconnecting waits
    network.connect(interface="virtual", channel="echoes", **options)
    try:
        return network.hears_itself, bool(network.bus.receive_own_messages)
    finally:
        network.disconnect()


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


def test_without_being_told_it_does_not() -> None:
    assert echoes() == (False, False)


@pytest.mark.parametrize(
    ("value", "wanted"),
    [
        *((True, True), (1, True), ("True", True), ("1", True)),
        *((False, False), (0, False), ("False", False), ("0", False)),
    ],
)
def test_by_an_option_or_the_environment(
    value: object, wanted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert echoes(receive_own_messages=value) == (wanted, wanted)
    monkeypatch.setenv("CAN_CONFIG", json.dumps({"receive_own_messages": value}))
    assert echoes() == (wanted, wanted)
    assert echoes(receive_own_messages=not wanted) == (not wanted, not wanted)


@pytest.mark.parametrize(("value", "wanted"), [("True", True), ("False", False)])
def test_by_a_file(value: str, wanted: bool, home: Path) -> None:
    text = f"[default]\n[echoing]\nreceive_own_messages = {value}\n"
    (home / ".canrc").write_text(text)
    assert echoes(config_context="echoing") == (wanted, wanted)
    assert echoes() == (False, False)


def test_a_text_is_none_but_a_text_without_a_configuration() -> None:
    assert echoes(ignore_config=True, receive_own_messages="False") == (True, True)


def test_network_listener_survives_datagrams_without_a_frame(multicast: dict[str, Any]) -> None:
    network = TappedNetwork()
    network.NOTIFIER_CYCLE = 0.01
    network.connect(**multicast)
    heard: Queue[bytes] = Queue()
    network.subscribe(0x181, lambda _can_id, data, _stamp: heard.put(bytes(data)))
    try:
        with can.Bus(**multicast) as sender, socket.socket(type=socket.SOCK_DGRAM) as foreign:
            foreign.sendto(b"no message" * 10, (multicast["channel"], multicast["port"]))
            sender.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=b"after"))
            assert heard.get(timeout=GUARD_S) == b"after"
            network.check()
    finally:
        network.disconnect()
