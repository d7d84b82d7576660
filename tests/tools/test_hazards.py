"""Every hazard names watchdogs and tests that exist, and every watchdog stands for a hazard."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

import pytest

from smarttac_can.vocabulary.watchdogs import Watchdog

ROOT = Path(__file__).resolve().parents[2]
CAUSES = [
    cause
    for hazard in tomllib.loads((ROOT / "tools" / "hazards.toml").read_text())["hazard"]
    for cause in hazard["cause"]
]


@pytest.mark.parametrize("cause", CAUSES, ids=[cause["what"] for cause in CAUSES])
def test_the_tests_of_a_cause_exist(cause: dict[str, list[str]]) -> None:
    assert cause["tests"]
    for test in cause["tests"]:
        file, _, name = test.partition("::")
        tree = ast.parse((ROOT / file).read_text())
        assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, test


def test_every_watchdog_stands_for_a_hazard() -> None:
    named = {name for cause in CAUSES for name in cause["watchdogs"]}
    assert named == {watchdog.name for watchdog in Watchdog}
