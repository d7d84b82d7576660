"""Whether a bus echoes is known however python-can was told: by option, environment or file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from smarttac_can.bench.tapped_network import TappedNetwork


def echoes(**options: Any) -> tuple[bool, bool]:
    """What the network says of itself, and what python-can has made of the bus."""
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
