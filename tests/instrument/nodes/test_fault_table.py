"""Every fault in one mode, some under both predictive laws: 0 V in time, and back after a reset.

``tools/pages/make faults --check`` runs each in every mode that drives.
"""

from __future__ import annotations

import random

import pytest
from driven import STATE, reset_fault, write
from line import EMCY_STIMULATOR, emergency_codes

from smarttac_can.assurance.trials.fault_cases import CASES, DRIVING, PREDICTED, FaultCase
from smarttac_can.assurance.trials.fault_matrix import begin_run, driving_rig
from smarttac_can.assurance.trials.rig import MasterTraffic, Rig
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od.cia import NMTCommand
from smarttac_can.vocabulary.states import Mode, State
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

BOUND = {
    "NMT stop": 3,
    "NMT pre-operational": 3,
    "NMT reset node": 3,
    "NMT reset communication": 3,
    "NMT stop of the plate": 1,
    "NMT reset of the plate": 1,
    "NMT stop, plate inside": 1,
    "heartbeat of the master lost": 1000,
    "heartbeat of the master lost, plate inside": 1000,
    "heartbeat of the plate lost": 2000,
    "master boots again": 1,
    "measurements lost": 3,
    "drives lost": 3,
    "set-points lost": 5,
    "SYNC lost": 3,
    "SYNC twice a cycle": 16,
    "SYNC counter jumps": 1,
    "bus-off": 3,
    "transmit queue full": 3,
    "controller asks for 999 V": 1,
    "controller gives NaN": 1,
    "another plate": 1,
    "plate without a serial number": 1,
    "another node speaks as the stimulator": 1,
    "another node speaks as the stimulator, plate inside": 1,
    "another node speaks as the plate": 1,
    "another node sends drives": 1,
    **{f"S{number} stuck": 24 for number in range(1, 7)},
    **{f"S{number} dead": 24 for number in range(1, 7)},
    **{f"S{number} saturated": 2 for number in range(1, 7)},
    **{f"S{number} jumps": 5 for number in range(3, 7)},
    "S1 off in 4 of 5 cycles": 7,
    "S3 off in 4 of 5 cycles": 7,
    "S4 off in 1 of 2 cycles": 11,
    "S6 off in 1 of 3 cycles": 16,
    **{f"pick-up {axis} {what}": 24 for axis in "dq" for what in ("stuck", "dead")},
    **{f"pick-up {axis} saturated": 2 for axis in "dq"},
    "S3 saturated, plate inside": 2,
    "pick-up reads too much": 10,
    **{f"pick-up at {gain}": 43 for gain in (0.05, 0.1, 0.2, 0.3, 0.4)},
    **{f"pick-up d at {gain}": 43 for gain in (0.05, 0.1, 0.2, 0.3, 0.4)},
    **{f"pick-up d at {gain}, tracked": 143 for gain in (0.05, 0.1, 0.2)},
    "thermometer stuck": 100,
    "thermometer jumps": 1,
    "plate too hot": 1,
    "finger slams": 6,
    "lateral force": 1,
    "resonance out of reach": 103,
    "plate cracked": 13,
    "vibration above its limit": 10,
    "vibration above its limit, identifying": 5,
    "power stage stuck": 1,
    "hardware takes its enable away": 1,
    "hardware falls silent": 3,
    "hardware reads 10 V more": 5,
    "measurements two cycles late": 3,
    "drives two cycles late": 3,
    "measurements swapped": 3,
    "drives corrupt": 3,
    "measurements corrupt": 3,
    "a node babbles": 3,
    "stimulator restarts": 3,
    "stimulator restarts, plate inside": 1,
    "plate restarts": 1,
    "clock of the stimulator jumps": 1,
    "clock of the plate jumps": 1,
    "clock of the stimulator stops": 16,
    "stimulator paused for 2 s": 3,
    "plate paused for 2 s": 1,
    "master paused": 3,
}
"""Cycles from a fault to its detection; a cycle later the plate is at 0 V."""
LATCHED = {
    "NMT stop of the plate": 3,
    "NMT reset of the plate": 3,
    "plate restarts": 3,
    "power stage stuck": 13,
    "pick-up d saturated": 6,
    "pick-up q saturated": 6,
}
"""Cycles until the stimulator has latched it, where the plate is at 0 V before."""
TO_SHOW = {
    # Sound cycles between the faulty ones, and the decrease of the leaky bucket in them.
    "S1 off in 4 of 5 cycles": 2,
    "S3 off in 4 of 5 cycles": 2,
    "S4 off in 1 of 2 cycles": 6,
    "S6 off in 1 of 3 cycles": 11,
    "drives lost": 2,
    "drives two cycles late": 2,
    "drives corrupt": 2,
    # The amplitude loop takes the voltage back in between.
    "pick-up reads too much": 4,
    "vibration above its limit": 5,
    # More vibration than the pick-up reads makes 0 V, which a stuck stage obeys.
    "power stage stuck": 1,
    "finger slams": 5,
    "resonance out of reach": 3,
    "plate cracked": 3,
    "transmit queue full": 1,
    "hardware falls silent": 3,
    "hardware reads 10 V more": 4,
    **{f"{axes} at 0.3": 8 for axes in ("pick-up", "pick-up d")},
    **{f"{axes} at 0.4": 23 for axes in ("pick-up", "pick-up d")},
    **{f"pick-up d at {gain}, tracked": 10 for gain in (0.05, 0.1, 0.2)},
}
"""Cycles until a watchdog can see its cause; its bound in `WATCHDOGS` counts from then on."""
SWUNG = {
    ("pick-up d at 0.05, tracked", Mode.TEXTURE): 18,
    ("pick-up d at 0.2, tracked", Mode.TEXTURE): 21,
    ("power stage stuck", Mode.TEXTURE): 2,
}
"""The same in mode TEXTURE, where the vibration passes amplitudes at which no phase is judged, and
0 V is asked for where the texture falls."""
UNLATCHED = {
    "stimulator restarts": State.NOT_READY,
    "stimulator restarts, plate inside": State.NOT_READY,
    "stimulator paused for 2 s": State.RUNNING,
}
"""State of the stimulator after faults that it cannot know of."""
UNHEARD = (
    "NMT stop", "NMT stop, plate inside", "a node babbles", "bus-off", "transmit queue full"
)  # fmt: skip
"""Faults that hold the emergency message back until they are over."""
LOST = ("bus-off",)
"""Faults that lose the emergency message."""
CROWDED = ("clock of the stimulator jumps",)
"""Faults followed by so many others that the error history no longer holds the first."""
RESETTABLE = (
    "master boots again",
    "bus-off",
    "NMT stop of the plate",
    "NMT reset of the plate",
    "plate restarts",
    "plate paused for 2 s",
    "clock of the stimulator jumps",
    "measurements two cycles late",
    "a node babbles",
    "pick-up d dead",
    "pick-up reads too much",
    "resonance out of reach",
    "plate cracked",
    "vibration above its limit",
    "vibration above its limit, identifying",
    "power stage stuck",
    *(f"pick-up at {gain}" for gain in (0.05, 0.1, 0.2, 0.3, 0.4)),
    *(f"pick-up d at {gain}" for gain in (0.05, 0.1, 0.2, 0.3, 0.4)),
    *(f"pick-up d at {gain}, tracked" for gain in (0.05, 0.1, 0.2)),
)
"""Lasting faults with which a reset is not tried before they are removed.

They are over after a while or after an NMT start, do not show at 0 V, or let no reset through.
"""
ROWS = [
    *((case, case.modes[number % len(case.modes)]) for number, case in enumerate(CASES)),
    *((case, Mode.FRICTION) for case in PREDICTED[::3]),
]


def cycles_to_latch(rig: Rig, most: int) -> int:
    for count in range(most + 1):
        if rig.state is State.FAULT:
            return count
        rig.cycle()
    raise AssertionError(f"no fault in {most} cycles")


def assert_at_0_v_in_time(rig: Rig, case: FaultCase, mode: Mode) -> None:
    bound, watchdog = BOUND[case.name], case.trips(mode)
    latched = 0
    if watchdog is None:
        assert rig.state is not State.FAULT
    else:
        latched = cycles_to_latch(rig, LATCHED.get(case.name, bound) + 1)
        told = WATCHDOGS[watchdog].bound
        if isinstance(told, int) and watchdog is case.watchdog:
            to_show = SWUNG.get((case.name, mode), TO_SHOW.get(case.name, 0))
            assert latched <= told + to_show + 1
    rig.cycle(max(0, bound + 1 - latched))
    assert rig.stage.read() == 0


def assert_told(rig: Rig, case: FaultCase, mode: Mode, frames: list[Frame]) -> None:
    """Check that the objects and one emergency message name the first watchdog."""
    watchdog = case.trips(mode)
    if watchdog is None:
        assert rig.state is UNLATCHED[case.name]
        assert rig.od["Diagnosis.Latched"].value == 0
        return
    row = WATCHDOGS[watchdog]
    # A fault that also ends an identification stays the cause.
    assert rig.od["Message"].value == row.text
    assert rig.od["Diagnosis.Code"].value == row.code
    assert rig.od["Diagnosis.Latched"].value >> watchdog & 1
    assert rig.od["Drive.Voltage"].value == 0
    sent = [frame.data for frame in frames if frame.can_id == EMCY_STIMULATOR]
    found = [data for data in sent if int.from_bytes(data[:2], "little") == row.code]
    if case.name in UNHEARD:
        assert not found
        return
    assert len(found) == 1
    emcy = found[0]
    assert emcy[2] & row.register
    assert emcy[2] & 1
    assert emcy[3] == watchdog
    if case.name not in CROWDED:
        assert row.code in [rig.od.entry(0x1003, n).value & 0xFFFF for n in range(1, 9)]


def random_traffic(rig: Rig, case: FaultCase, cycles: int) -> None:
    """Send all that could have the plate driven, but no reset of the fault."""
    draw = random.Random(1)
    commands = not case.forgets
    traffic = MasterTraffic(rig, 1, commands=commands)
    for _ in range(cycles):
        traffic.send()
        if commands:
            rig.master.send(Frame(0x220, bytes((draw.randrange(8), 0, draw.randrange(6)))))
        rig.cycle()


def assert_reset_when_over(rig: Rig, case: FaultCase, mode: Mode, frames: list[Frame]) -> None:
    watchdog = case.trips(mode)
    if watchdog is not None and WATCHDOGS[watchdog].lasting and case.name not in RESETTABLE:
        assert reset_fault(rig) == STATE, "it is still there"
    case.remove(rig)
    rig.nmt(NMTCommand.START)
    rig.configure()
    rig.cycle(130)
    if watchdog is not None and case.name not in LOST:
        assert WATCHDOGS[watchdog].code in emergency_codes(frames, EMCY_STIMULATOR)
    if not case.forgets:
        before = len(frames)
        assert rig.state is State.FAULT
        assert reset_fault(rig) == 0, bin(rig.od["Diagnosis.Present"].value)
        assert 0 in emergency_codes(frames[before:], EMCY_STIMULATOR)
    assert rig.state is not State.FAULT
    assert rig.od["Diagnosis.Code"].value == rig.od["Diagnosis.Latched"].value == 0
    assert write(rig, "Controlword", 0) == 0


def assert_drives_again(rig: Rig, case: FaultCase, mode: Mode) -> None:
    begin_run(rig, case, mode)
    rig.drive(mode)
    rig.cycle(130 if mode is Mode.IDENTIFY else 60)
    assert rig.state is State.RUNNING
    assert rig.stage.read() > 0


@pytest.mark.parametrize(
    ("case", "mode"), ROWS, ids=[f"{case.name}, {case.way(mode)}" for case, mode in ROWS]
)
def test_fault(case: FaultCase, mode: Mode) -> None:
    frames: list[Frame] = []
    rig = driving_rig(case, mode, lambda _time, frame: frames.append(frame))
    rig.cycle(50)
    assert rig.stage.read() > 0
    frames.clear()
    case.inject(rig)
    assert_at_0_v_in_time(rig, case, mode)

    def stays_at_0_v() -> None:
        assert rig.stage.read() == 0

    rig.observe = stays_at_0_v
    assert_told(rig, case, mode, frames)
    random_traffic(rig, case, 60)
    assert_reset_when_over(rig, case, mode, frames)
    rig.observe = None
    assert_drives_again(rig, case, mode)


def test_the_bounds_are_those_of_the_table() -> None:
    assert {case.name: case.bound for case in CASES} == BOUND
    assert all(case.bound == BOUND[case.name] for case in PREDICTED)


@pytest.mark.parametrize("mode", DRIVING)
def test_every_watchdog_trips_in_every_mode(mode: Mode) -> None:
    tripped = {case.trips(mode) for case in CASES if mode in case.modes}
    # These have tests of their own, in test_missed_time.py and test_real_time.py.
    left = {Watchdog.MISSED_TIME, Watchdog.UNSEEN}
    if mode not in (Mode.AMPLITUDE_RESONANCE, Mode.FRICTION, Mode.TEXTURE):
        left.add(Watchdog.RESONANCE)
    assert set(Watchdog) - tripped == left
