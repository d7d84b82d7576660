"""A plugin of pytest: every node that a test makes has a shadow, which hears what it hears.

``pytest -p shadowed tests/nodes`` runs the tests as they are. Beside each stimulator or plate node
that one makes, a `pair.Pair` gets the same calls and the same time; the test fails if old and new
then differ. So what the tests know of orders of NMT, remapping, SDO and cycles is a corpus. What a
test changes inside its node, and not by frames, its shadow does not get.

``SHADOW_OLD`` in the environment names the commit of the old implementation, as for `frozen.old`.
"""

from __future__ import annotations

import functools
import os
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, Final
from unittest.mock import patch

import pytest
from frozen import BASELINE, NEW, Package, old
from pair import BothFailed, Difference, Pair, side

CALLS: Final = (
    *("start", "receive", "overtaken", "advance", "segments", "overdue", "transmit_failed"),
    *("bus_off", "bus_recovered", "shutdown"),
)
MOST_CALLS: Final = 30_000
"""Calls of a node that its shadow hears, from the first on."""
ALL_EVERY: Final = 16
"""Every how many calls all is compared."""
_KINDS: Final = {"StimulatorNode": "nodes.stimulator_node", "PlateNode": "nodes.plate_node"}

differences: list[Difference] = []
"""Those of the test that runs."""
counts: Counter[str] = Counter()
"""Nodes that had a shadow, those that had none, and calls."""
_making = False


def _copies(kind: str, node_od: Any, options: dict[str, Any]) -> Iterator[tuple[Package, Any]]:
    """Yield the same node of both implementations; ValueError if it cannot be made again."""
    changed = _changed(node_od)
    inside = options.pop("plate", None)
    storage = options.pop("storage", None)
    kept = None if storage is None else storage.read()
    for package in (old(os.environ.get("SHADOW_OLD") or BASELINE), NEW):
        simulation = package.module("bench.simulation")
        make_od = simulation.plate_od if kind == "PlateNode" else simulation.stimulator_od
        od = make_od(node_od.node_id)
        for index, subindex, default, value in changed:
            entry = od.entry(index, subindex)
            entry.default, entry.value = default, value
        more = dict(options)
        if inside is not None:
            plate_od = simulation.plate_od(inside.od.node_id)
            more["plate"] = package.module("nodes.plate_block").PlateBlock(plate_od)
        if storage is not None:
            more["storage"] = package.module("device.storage").Memory()
            if kept is not None:
                more["storage"].write(kept)
        yield package, getattr(package.module(_KINDS[kind]), kind)(od, **more)


def _changed(od: Any) -> list[tuple[int, int, Any, Any]]:
    """Return what a test has changed in an object dictionary before it made its node."""
    simulation = NEW.module("bench.simulation")
    makers = [simulation.stimulator_od, simulation.plate_od]
    fresh = next((f for make in makers if (f := make(od.node_id)).text == od.text), None)
    if fresh is None:
        raise ValueError("another EDS")
    return [
        (entry.index, entry.subindex, entry.default, entry.read())
        for entry, sound in zip(od, fresh, strict=True)
        if entry.source is None and (entry.default, entry.value) != (sound.default, sound.value)
    ]


def _pair(kind: str, od: Any, options: dict[str, Any]) -> Pair | None:
    """Make the shadow of a node that is about to be made; None if it cannot be made again."""
    if any(options.get(name) is not None for name in ("recording", "front_end")):
        return None
    try:
        (first, before), (second, now) = _copies(kind, od, dict(options))
    except (ValueError, OSError):
        return None
    plate = kind == "PlateNode"
    return Pair(kind, side(first, before, plate=plate), side(second, now, plate=plate))


def _told(node: Any, pair: Pair, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
    """Return a call of a node that its shadow hears first."""

    @functools.wraps(call)
    def told(*arguments: Any) -> Any:
        if pair.calls < MOST_CALLS:
            _hear(node, pair, name, arguments)
        return call(*arguments)

    return told


def _hear(node: Any, pair: Pair, name: str, arguments: tuple[Any, ...]) -> None:
    counts["calls"] += 1
    if pair.clock.now != node.clock.now:
        pair.clock.now = node.clock.now
    try:
        getattr(pair, name)(*arguments)
        pair.look(all_of_it=pair.calls % ALL_EVERY == 0)
    except Difference as difference:
        differences.append(difference)
        pair.calls = MOST_CALLS
    except BothFailed:
        pair.calls = MOST_CALLS


def _with_shadow(kind: str, sound: Callable[..., None]) -> Callable[..., None]:
    """Return what makes a node, and its shadow before it."""
    places = ("presets", "recording") if kind == "PlateNode" else ("plate",)

    @functools.wraps(sound)
    def made(node: Any, od: Any, *arguments: Any, **options: Any) -> None:
        global _making  # noqa: PLW0603 - a shadow has none itself
        pair = None
        if not _making:
            _making = True
            try:
                pair = _pair(kind, od, {**dict(zip(places, arguments, strict=False)), **options})
            finally:
                _making = False
            counts["without a shadow" if pair is None else "with a shadow"] += 1
        sound(node, od, *arguments, **options)
        if pair is not None:
            for name in CALLS:
                setattr(node, name, _told(node, pair, name, getattr(node, name)))

    return made


def pytest_configure(config: pytest.Config) -> None:
    """Have nodes be made with a shadow from now on."""
    for kind, path in _KINDS.items():
        owner = getattr(NEW.module(path), kind)
        patched = patch.object(owner, "__init__", _with_shadow(kind, owner.__init__))
        patched.start()
        config.add_cleanup(patched.stop)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Fail a test in which a shadow has found a difference."""
    differences.clear()
    yield
    if differences:
        raise differences[0]


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Say what was compared."""
    shown = ", ".join(f"{number} {name}" for name, number in sorted(counts.items()))
    terminalreporter.write_line(f"shadows: {shown or 'none'}")
