"""A plugin of pytest: every node that a test makes has a shadow, which hears what it hears.

``pytest -p shadowed tests/nodes`` runs the tests as they are. Beside each stimulator or plate node,
and each device without an application, a `pair.Pair` gets the same calls and the same time; the
test fails if old and new then differ. So what the tests know of orders of NMT, remapping, SDO and
cycles is a corpus. What a test changes inside its node, and not by frames, its shadow does not get.

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
    *("take", "trigger", "emergency", "clear_emergency", "react"),
)
"""What a test calls of a node, or of a device."""
MOST_CALLS: Final = 30_000
"""Calls of a node that its shadow hears, from the first on."""
ALL_EVERY: Final = 16
"""Every how many calls all is compared of a node; of a device it is at each."""
_MODULES: Final = {
    "StimulatorNode": "nodes.stimulator_node",
    "PlateNode": "nodes.plate_node",
    "Device": "device.device",
}
_PLACES: Final = {
    "StimulatorNode": ("plate",),
    "PlateNode": ("presets", "recording"),
    "Device": ("application",),
}
"""Names of the arguments that have a place, behind the object dictionary."""
_PDOS: Final = range(0x180, 0x580)
_STRANGE: Final = ("recording", "front_end", "application")
"""Arguments of which there is no second one: what has them gets no shadow."""

BREAK_IT: Final = (
    "test_values_outside_their_limits_are_found",
    "test_transfers_without_time_out_are_found",
    "test_no_frame_has_more_than_a_sub_block_summed_up",
)
"""Tests that break this tree, or count what it calls: they are left out."""

differences: list[Difference] = []
"""Those of the test that runs."""
counts: Counter[str] = Counter()
"""Nodes that had a shadow, those that had none, and calls."""
_making = False


def _copies(kind: str, od: Any, options: dict[str, Any]) -> Iterator[tuple[Package, Any]]:
    """Yield the same node of both implementations.

    Raises
    ------
    ValueError
        If it has not just an EDS, and what a test has changed in its values.
    """
    changed = _changed(od)
    inside = options.pop("plate", None)
    changed_inside = [] if inside is None else _changed(inside.od)
    storage = options.pop("storage", None)
    kept = None if storage is None else storage.read()
    options.pop("clock", None)
    for package in (old(os.environ.get("SHADOW_OLD") or BASELINE), NEW):
        more = dict(options)
        if inside is not None:
            block = package.module("nodes.plate_block").PlateBlock
            more["plate"] = block(_copy(package, inside.od, changed_inside))
        if storage is not None:
            more["storage"] = package.module("device.storage").Memory()
            if kept is not None:
                more["storage"].write(kept)
        node = getattr(package.module(_MODULES[kind]), kind)
        yield package, node(_copy(package, od, changed), **more)


def _copy(package: Package, od: Any, changed: list[tuple[int, int, Any, Any]]) -> Any:
    """Return the object dictionary of a package with the same EDS and the same values."""
    copy = package.module("od.eds").load_eds(od.text, od.node_id)
    for index, subindex, default, value in changed:
        entry = copy.entry(index, subindex)
        entry.default, entry.value = default, value
    return copy


def _changed(od: Any) -> list[tuple[int, int, Any, Any]]:
    """Return what a test has changed in an object dictionary before it made its node."""
    fresh = NEW.module("od.eds").load_eds(od.text, od.node_id)
    return [
        (entry.index, entry.subindex, entry.default, entry.read())
        for entry, sound in zip(od, fresh, strict=True)
        if entry.source is None and (entry.default, entry.value) != (sound.default, sound.value)
    ]


def _pair(kind: str, od: Any, options: dict[str, Any]) -> Pair | None:
    """Make the shadow of a node that is about to be made; None if it cannot be made again."""
    if any(options.get(name) is not None for name in _STRANGE):
        return None
    try:
        (first, before), (second, now) = _copies(kind, od, dict(options))
    except (ValueError, OSError):
        return None
    return Pair(kind, side(first, before, kind), side(second, now, kind))


def _told(node: Any, pair: Pair, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
    """Return a call of a node that its shadow hears first."""

    @functools.wraps(call)
    def told(*arguments: Any, **options: Any) -> Any:
        if pair.calls < MOST_CALLS:
            _hear(node, pair, name, arguments, options)
        return call(*arguments, **options)

    return told


def _hear(
    node: Any, pair: Pair, name: str, arguments: tuple[Any, ...], options: dict[str, Any]
) -> None:
    counts["calls"] += 1
    if pair.clock.now != node.clock.now:
        pair.clock.now = node.clock.now
    try:
        pair.call(name, *arguments, **options)
        if not _is_pdo(arguments):
            pair.look(all_of_it=pair.name == "Device" or pair.calls % ALL_EVERY == 0)
    except Difference as difference:
        differences.append(difference)
        pair.calls = MOST_CALLS
    except BothFailed:
        pair.calls = MOST_CALLS


def _is_pdo(arguments: tuple[Any, ...]) -> bool:
    """Whether a call is one of the many PDOs of a cycle, whose frames alone are compared."""
    return bool(arguments) and isinstance(arguments[0], tuple) and arguments[0][0] in _PDOS


def _with_shadow(kind: str, sound: Callable[..., None]) -> Callable[..., None]:
    """Return what makes a node, and its shadow before it."""

    @functools.wraps(sound)
    def made(node: Any, od: Any, *arguments: Any, **options: Any) -> None:
        global _making  # noqa: PLW0603 - a shadow has none itself
        pair = None
        if not _making:
            _making = True
            try:
                placed = dict(zip(_PLACES[kind], arguments, strict=False))
                pair = _pair(kind, od, {**placed, **options})
            finally:
                _making = False
            counts["without a shadow" if pair is None else "with a shadow"] += 1
        sound(node, od, *arguments, **options)
        if pair is not None:
            for name in CALLS:
                if hasattr(node, name):
                    setattr(node, name, _told(node, pair, name, getattr(node, name)))

    return made


def pytest_configure(config: pytest.Config) -> None:
    """Have nodes be made with a shadow from now on."""
    for kind, path in _MODULES.items():
        owner = getattr(NEW.module(path), kind)
        patched = patch.object(owner, "__init__", _with_shadow(kind, owner.__init__))
        patched.start()
        config.add_cleanup(patched.stop)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave out the tests that break this tree."""
    items[:] = [item for item in items if item.name not in BREAK_IT]


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
