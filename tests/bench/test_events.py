"""State changes, faults and heartbeats as an iterator, over each link."""

import signal
import threading
from contextlib import ExitStack
from typing import Any

import pytest
from nodes_on_a_bus import GUARD_S, in_threads, stimulator_with_plate, until

from smarttac_can.bench import BenchError, Event, FaultError, State, Stimulator
from smarttac_can.vocabulary.faults import FaultKind

STUCK = Event(32, "fault", "a sensor is stuck")


def state(state: State) -> Event:
    return Event(32, "state", state.name.lower().replace("_", " "), state)


def test_a_run_a_fault_and_its_end_over_every_link(bench: Stimulator) -> None:
    bench.run(0.1)  # tared
    bench.voltage = 10
    with bench.events() as events:
        bench.mode = "open_loop"
        assert list(events.within(0)) == [state(State.ARMED), state(State.RUNNING)]
        bench.set("Fault.Sensor", 1)
        bench.set("Fault.Kind", FaultKind.STUCK)
        come = list(events.within(0.2))
        assert sorted(come, key=lambda event: event.kind) == [STUCK, state(State.FAULT)]
        bench.set("Fault.Kind", FaultKind.NONE)
        assert not list(events.within(0.1))
        bench.reset_fault()
        assert [event.state for event in events.within(0.1)][-1] is State.READY


def test_listening_changes_no_transmission_type() -> None:
    with Stimulator.simulate() as bench:
        types = bench._link._every_cycle._types
        before = [bench._link._stimulator.read(entry) for entry in types]
        with bench.events():
            now = [bench._link._stimulator.read(entry) for entry in types]
    assert now == before


def test_events_during_a_run_are_kept(bench: Stimulator) -> None:
    bench.run(0.1)
    bench.voltage = 10
    bench.mode = "open_loop"
    bench.set("Fault.Sensor", 1)
    with bench.events() as events, bench.events() as others:
        bench.set("Fault.Kind", FaultKind.STUCK)
        with pytest.raises(FaultError):
            bench.run(0.2)
        come = list(events.within(0))
        assert STUCK in come
        assert state(State.FAULT) in come
        assert list(others.within(0)) == come
    assert not bench.get("Mode")


def test_the_loop_runs_up_to_an_event_and_on_with_the_next(bench: Stimulator) -> None:
    bench.run(0.1)
    bench.voltage = 10
    bench.mode = "open_loop"
    bench.set("Fault.Sensor", 1)
    bench.set("Fault.Kind", FaultKind.STUCK)
    begun = bench.get("Cycle.Cycles")
    with bench.events() as events:
        within = events.within(0.2)
        next(within)
        # 24 equal samples are a fault; sensors 1 and 2 share the drive of the cycle before.
        assert 20 < bench.get("Cycle.Cycles") - begun < 30
        list(within)
        assert bench.get("Cycle.Cycles") - begun == 200


@pytest.mark.parametrize("seconds", [-0.1, 604_801, float("nan"), "1"])
def test_a_time_that_is_none_is_refused(seconds: Any) -> None:
    with Stimulator.simulate("local") as bench, bench.events() as events:
        with pytest.raises(ValueError, match="seconds"):
            events.within(seconds)
        assert not list(events.within(0))


def test_events_come_in_the_block_only() -> None:
    with Stimulator.simulate("local") as bench:
        events = bench.events()
        with pytest.raises(BenchError, match="events come only inside a with block"):
            events.within(1)
        with events:
            bench.disarm()
        with pytest.raises(BenchError, match="events come only inside a with block"):
            events.within(1)


def test_a_statusword_that_no_tpdo_maps_is_named() -> None:
    with Stimulator.simulate("bus", presets={}) as bench:
        link = bench._link
        status = next(pdo for pdo in link.source().published if "Statusword" in pdo.names)
        status.names[status.names.index("Statusword")] = "another"
        with pytest.raises(BenchError, match="no TPDO of node 32 maps the Statusword"):
            bench.events().__enter__()


def test_a_node_that_dies_and_comes_back(
    virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    with ExitStack() as stack:
        with in_threads(virtual, stimulator_with_plate(lockstep=False), lockstep=False):
            bench = stack.enter_context(Stimulator.connect(**virtual))
            events = stack.enter_context(bench.events())
            until(lambda: bench.state is State.READY)
            # A second of heartbeats that show the same is no event.
            assert {event.state for event in events.within(1.2)} <= {State.READY}
        # Only now, as a node of a busy machine may be late by more than two heartbeats.
        monkeypatch.setattr("smarttac_can.bench.remote_device._HEARTBEATS_MISSED", 2)
        lost = next(event for event in events.within(GUARD_S) if event.kind == "heartbeat")
        assert lost == Event(32, "heartbeat", "lost")
        # Said once.
        assert not list(events.within(0.3))
        monkeypatch.undo()
        with in_threads(virtual, stimulator_with_plate(lockstep=False), lockstep=False):
            back = next(events.within(GUARD_S))
            assert back == Event(32, "heartbeat", "boot-up")
            shown = next(event for event in events.within(GUARD_S))
            assert shown == Event(32, "heartbeat", "pre-operational")
            stack.close()


def test_beside_a_run_in_another_thread(virtual: dict[str, Any]) -> None:
    with (
        in_threads(virtual, stimulator_with_plate(lockstep=False), lockstep=False),
        Stimulator.connect(**virtual) as bench,
        bench.events() as events,
    ):

        def drive() -> None:
            bench.voltage = 10
            bench.mode = "open_loop"
            bench.run(0.2)
            bench.disarm()

        thread = threading.Thread(target=drive)
        thread.start()
        states = []
        for event in events.within(GUARD_S):
            states.append(event.state)
            if states[-2:] == [State.RUNNING, State.READY]:
                break
        thread.join()
        assert State.ARMED in states


def test_events_of_other_blocks_outlast_a_block_that_ends(
    virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[set[int]] = []
    monkeypatch.setattr(
        "smarttac_can.bench.can_link.receive_only", lambda _bus, ids: heard.append(set(ids))
    )
    with (
        in_threads(virtual, stimulator_with_plate()),
        Stimulator.connect(**virtual, lockstep=True) as bench,
    ):
        before = heard[-1]
        first, second = bench.events(), bench.events()
        first.__enter__()
        second.__enter__()
        first.__exit__()
        assert 0x80 + 32 in heard[-1]
        second.__exit__()
        assert heard[-1] == before


def test_ctrl_c_ends_a_wait_between_two_cycles() -> None:
    with Stimulator.simulate("local") as bench, bench.events() as events:
        timer = threading.Timer(0.1, signal.raise_signal, [signal.SIGINT])
        bench.run(0.1)
        list(events.within(0))
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            list(events.within(600_000))
        timer.join()
        assert len(bench.run(0.01)) == 10
