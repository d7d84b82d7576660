"""The screen, headless, against a simulated node on a bus of its own.

Keys are posted without ``Pilot.press``: it waits until the process is idle, and the node in a
thread never lets it be.
"""

import asyncio
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack
from functools import partial
from typing import Any

import pytest
from nodes_on_a_bus import GUARD_S, in_threads, stimulator_with_plate
from textual.pilot import Pilot
from textual.widgets import Input, Static

from smarttac_can.bench import BenchError, Stimulator
from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.bench.watch.commands import HINT, in_words, obey
from smarttac_can.bench.watch.listener import Listener
from smarttac_can.bench.watch.screen import WatchScreen
from smarttac_can.bench.watch.watcher import Watcher
from smarttac_can.canopen.bus.bus import BusError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import Mode

Script = Callable[[Pilot[None], WatchScreen], Awaitable[None]]


@pytest.fixture
def node(virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> Iterator[StimulatorNode]:
    """Run a node in a thread, which ends no run because the machine is busy."""
    # The process that draws sends the heartbeat of the commander.
    monkeypatch.setattr("smarttac_can.bench.remote_device._LOST_MS", 5000)
    made = stimulator_with_plate(lockstep=False)
    with in_threads(virtual, made, lockstep=False):
        yield made


def shown(screen: WatchScreen) -> str:
    return "\n".join(str(part.render()) for part in screen.query(Static))


async def until_true(pilot: Pilot[None], screen: WatchScreen, true: Callable[[], object]) -> None:
    """Look at the screen until something is true; the bound is a guard."""
    guard = time.monotonic() + GUARD_S
    while not true():
        assert time.monotonic() < guard, shown(screen)
        await pilot.pause(0.05)


async def until(pilot: Pilot[None], screen: WatchScreen, text: str) -> None:
    """Return once the screen shows a text."""
    await until_true(pilot, screen, lambda: text in shown(screen))


def enter(screen: WatchScreen, line: str) -> None:
    screen.query_one(Input).value = line
    screen.simulate_key("enter")


def play(
    bus: dict[str, Any],
    script: Script,
    *,
    drive: bool = False,
    adapter: type[PythonCanBus] = PythonCanBus,
) -> None:
    async def run(screen: WatchScreen) -> None:
        async with screen.run_test(size=(80, 24)) as pilot:
            await script(pilot, screen)

    with ExitStack() as stack:
        listener = stack.enter_context(Listener(lambda: adapter(**bus)))
        stimulator = stack.enter_context(Stimulator.connect(**bus)) if drive else None
        asyncio.run(run(WatchScreen(Watcher(stimulator_od()), listener, "a bus", stimulator)))


@pytest.mark.usefixtures("node")
def test_it_looks_on_while_another_bench_drives(virtual: dict[str, Any]) -> None:
    async def script(pilot: Pilot[None], screen: WatchScreen) -> None:
        await until(pilot, screen, "mode amplitude ")
        await until(pilot, screen, "set to    1.000 um")
        assert "state running" in shown(screen)
        screen.simulate_key("escape")  # a watch that only reads has no stop
        await pilot.pause(0.5)
        assert "state running" in shown(screen)
        assert not screen.query(Input)
        screen.simulate_key("q")

    with Stimulator.connect(**virtual) as bench:
        bench.amplitude = 1.0
        bench.mode = "amplitude"
        play(virtual, script)


def test_it_drives_and_stops(virtual: dict[str, Any], node: StimulatorNode) -> None:
    async def script(pilot: Pilot[None], screen: WatchScreen) -> None:
        await until(pilot, screen, "state ready")
        enter(screen, "amplitude 1.2")
        await until(pilot, screen, "done: amplitude 1.2 um")
        enter(screen, "mode amplitude")
        await until(pilot, screen, "done: mode amplitude")
        await until(pilot, screen, "state running")
        assert node.od["Mode display"].value == Mode.AMPLITUDE
        enter(screen, "amplitude 99")
        await until(pilot, screen, "amplitude 99 um is above 3 um")
        enter(screen, "dance")
        await until(pilot, screen, "'dance' is none of: mode NAME")
        enter(screen, "cof x")
        await until(pilot, screen, "cof 'x' is no number")
        enter(screen, "cof 0.2 0.3")
        await until(pilot, screen, "COF 0.200 left, 0.300 right")
        screen.simulate_key("escape")
        await until(pilot, screen, "mode off")
        await until(pilot, screen, "state ready")
        assert node.od["Mode display"].value == Mode.OFF
        screen.simulate_key("ctrl+c")

    play(virtual, script, drive=True)


def drive_late(screen: WatchScreen, begin: threading.Event) -> str:
    assert begin.wait(GUARD_S)
    assert screen._stimulator is not None
    try:
        screen._stimulator.mode = "amplitude"
    except BenchError as error:
        return f"late: {error}"
    return "late: done"


@pytest.mark.usefixtures("node")
def test_watch_stop_goes_out_while_a_command_hangs(virtual: dict[str, Any]) -> None:
    """While the one worker hangs the stop goes out, and its later effect is undone."""

    async def script(pilot: Pilot[None], screen: WatchScreen) -> None:
        await until(pilot, screen, "state ready")
        enter(screen, "mode amplitude")
        await until(pilot, screen, "done: mode amplitude")
        await until(pilot, screen, "state running")
        hanging = threading.Event()
        screen._operator.begin(partial(drive_late, screen, hanging))
        screen.simulate_key("escape")
        await until(pilot, screen, "mode off")
        hanging.set()
        await until(pilot, screen, "late: ")
        await until_true(pilot, screen, lambda: not screen._watcher.stopping)
        await until(pilot, screen, "mode off")
        assert "state ready" in shown(screen)

    play(virtual, script, drive=True)


def test_a_bus_that_is_unplugged_is_told_and_comes_back(virtual: dict[str, Any]) -> None:
    plugged = True

    class Pulled(PythonCanBus):
        def __init__(self, **options: Any) -> None:
            if not plugged:
                raise BusError("there is no such adapter")
            super().__init__(**options)
            read = self.read

            def pulled(frames: deque[Frame]) -> bool:
                if not plugged:
                    raise BusError("cannot receive: the adapter is gone")
                return read(frames)

            self.read = pulled

    async def script(pilot: Pilot[None], screen: WatchScreen) -> None:
        nonlocal plugged
        plugged = False
        await until(pilot, screen, "the bus is lost (cannot receive: the adapter is gone)")
        plugged = True
        await until(pilot, screen, "COF ")
        await until_true(pilot, screen, lambda: "the bus is lost" not in shown(screen))

    play(virtual, script, adapter=Pulled)


def test_it_ends_without_a_last_look(
    virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    take_down = WatchScreen._close_all

    async def slowly(screen: WatchScreen) -> None:
        await take_down(screen)
        await asyncio.sleep(0.3)  # while the next look falls due

    async def script(pilot: Pilot[None], screen: WatchScreen) -> None:
        await until(pilot, screen, "state -")

    monkeypatch.setattr(WatchScreen, "_close_all", slowly)
    play(virtual, script)


@pytest.mark.usefixtures("node")
def test_a_device_does_not_write_to_the_terminal(
    virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def latched(_stimulator: Stimulator, _text: str) -> str:
        raise BenchError("a fault is latched (\x1b[2Jall is well\x07)")

    monkeypatch.setattr("smarttac_can.bench.watch.screen.obey", latched)

    async def script(pilot: Pilot[None], screen: WatchScreen) -> None:
        enter(screen, "reset")
        await until(pilot, screen, "a fault is latched (?[2Jall is well?)")
        screen.simulate_key("ctrl+c")

    play(virtual, script, drive=True)


def test_set_points_take_units_as_at_the_bench() -> None:
    with Stimulator.simulate("local") as bench:
        for text in ("boundary 5000 um", "voltage 0.02 kV", "amplitude 1.5", "cof 30% 0.4"):
            assert obey(bench, text) == f"done: {in_words(text)}"
        assert (bench.boundary, bench.voltage, bench.amplitude) == pytest.approx((5, 20, 1.5))
        assert bench.cof == pytest.approx((0.3, 0.4))
        assert obey(bench, "cof - 0.5") == "done: COF right 0.5"
        assert obey(bench, "cof 0.2 -") == "done: COF left 0.2"
        assert bench.cof == pytest.approx((0.2, 0.5))
        obey(bench, "law predictive")
        obey(bench, "slot 3")
        assert (bench.law.name, bench.texture_slot) == ("PREDICTIVE", 3)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("cof", "'cof' is not of the form: cof C [C]"),
        ("slot one", "'slot one' is not of the form: slot N"),
        ("law of nature", "'law of nature' is not of the form: law NAME"),
        ("reset now", "'reset now' is not of the form: reset"),
        ("stop", f"'stop' is none of: {HINT}"),
        ("voltage 5 mm", "voltage '5 mm' is no number with a unit like V"),
        ("cof x", "cof 'x' is no number or percentage"),
        ("frequency inf", "frequency inf is not a finite number"),
        ("mode texture", "cannot play: texture slot 1 is empty: a script sets bench.texture first"),
    ],
)
def test_watch_command_reports_errors_in_one_line(text: str, reason: str) -> None:
    with Stimulator.simulate("local") as bench:
        with pytest.raises((ValueError, BenchError)) as refusal:
            obey(bench, text)
        assert str(refusal.value) == reason
