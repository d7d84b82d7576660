"""The newest faults outlive a reset; the latch does not depend on them."""

from driven import driven, write, write_entry
from line import RESET, START

from smarttac_can.trials.fault_cases import bus_off, bus_recovered
from smarttac_can.trials.rig import Rig
from smarttac_can.vocabulary.states import Mode, State

FIRST = "Fault memory.Fault 1"
LOAD = int.from_bytes(b"load", "little")


def faults(rig: Rig) -> list[str]:
    od = rig.od
    return [text for n in range(1, 9) if (text := od[f"Fault memory.Fault {n}"].value)]


def trip(rig: Rig) -> None:
    bus_off(rig)
    bus_recovered(rig)
    assert rig.state is State.FAULT


def recover(rig: Rig) -> None:
    rig.nmt(START, 0x20)
    rig.cycle(20)
    for word in (0, 0x80, 0):
        assert write(rig, "Controlword", word) == 0
    rig.start_run()
    rig.drive(Mode.OPEN_LOOP)
    rig.cycle(20)
    assert rig.stage.read() > 0


def test_a_fault_is_kept_with_its_cause_and_what_was_asked_for() -> None:
    rig = driven(Mode.AMPLITUDE)
    assert faults(rig) == []
    trip(rig)
    assert faults(rig) == [
        "8141h the CAN controller is bus-off; mode amplitude, Voltage 40000 mV, "
        "Frequency 43390 Hz, Amplitude 1000 nm, COF left 0.35, COF right 0.35"
    ]


def test_the_reset_of_the_fault_and_of_the_node_keep_it() -> None:
    rig = driven()
    trip(rig)
    (kept,) = faults(rig)
    recover(rig)
    assert faults(rig) == [kept]
    rig.nmt(RESET, 0x20)
    assert rig.state is State.FAULT, "out of RUNNING"
    assert faults(rig) == ["8180h NMT left OPERATIONAL while running; reset node", kept]
    rig.nmt(RESET, 0x20)
    assert rig.state is State.NOT_READY, "the memory is not the latch"
    assert len(faults(rig)) == 2


def test_no_default_is_restored_over_it() -> None:
    rig = driven()
    trip(rig)
    assert write(rig, "Controlword", 0) == 0
    assert write_entry(rig, rig.od.entry(0x1011, 1), LOAD) == 0
    rig.nmt(RESET, 0x20)
    rig.nmt(START, 0x20)
    assert len(faults(rig)) == 1


def test_eight_are_kept_the_newest_first() -> None:
    rig = driven()
    memory = rig.stimulator.block.supervisor.memory
    memory.recall(tuple(f"old {n}" for n in range(9)))
    assert faults(rig) == [f"old {n}" for n in range(8)]
    trip(rig)
    assert faults(rig)[0].startswith("8141h")
    assert faults(rig)[1:] == [f"old {n}" for n in range(7)]


def test_what_only_follows_is_no_fault_of_its_own() -> None:
    rig = driven()
    trip(rig)
    rig.heartbeat = False
    rig.cycle(80)
    assert len(faults(rig)) == 1
