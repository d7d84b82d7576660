"""Small things broken in this tree on purpose, each of which a shadow has to find.

A row names a function, a piece of its source and what stands there instead, a script that makes it
tell, and what is seen first. Who moves the function moves the row with it: what is broken, and what
shows it, stays.
"""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, NamedTuple
from unittest.mock import patch

from frozen import Package
from world import SAVE, Act, Setting


class Sabotage(NamedTuple):
    """One thing that is broken."""

    what: str
    place: str
    """Module below the package, and name in it."""
    sound: str
    broken: str
    seen: str
    """What is found to differ first: ``frames``, or how the name begins."""
    script: tuple[Act, ...]
    """Behind a run that drives in mode AMPLITUDE_RESONANCE under a finger."""
    setting: Setting = Setting()


BEGIN: Final[tuple[Act, ...]] = (("begin", 2, 500, 1), ("recover", 3), ("cycles", 70))
_RUN: Final[tuple[Act, ...]] = (("cycles", 3),)
_RESET: Final[tuple[Act, ...]] = (("nmt", 0x81, 0), ("cycles", 2))
_LEAVE: Final[tuple[Act, ...]] = (("nmt", 0x80, 0), ("nmt", 0x01, 0), ("cycles", 3))
_ODD: Final[tuple[Act, ...]] = (("fault", 3, 3, 600, 0), ("cycles", 3), ("fault", 0, 1, 0, 0))

SABOTAGES: Final = (
    Sabotage(
        "a watch counts one less", "nodes.watches leaked",
        "min(bucket + FORGOTTEN,", "min(bucket + FORGOTTEN - 1,",
        "watch gauges", _ODD,
    ),
    Sabotage(
        "a watch forgets twice as fast", "nodes.watches leaked",
        "bucket - 1 if", "bucket - 2 if",
        "watch gauges", (*_ODD, ("cycles", 3)),
    ),
    Sabotage(
        "a watch forgets nothing", "nodes.watches _counted",
        "count + 1 if faulty & bit else 0", "count + 1 if faulty & bit else count",
        "watch silent",
        (("fault", 4, 10, 10, 0), ("cycles", 4), ("fault", 0, 1, 0, 0), ("cycles", 3)),
    ),
    Sabotage(
        "a watch trips a cycle later", "nodes.watches _at_once",
        ">= STUCK_GAUGE_CYCLES", "> STUCK_GAUGE_CYCLES",
        "frames", (("fault", 1, 1, 0, 0), ("cycles", 40)),
    ),
    Sabotage(
        "a bound is off by a thousandth", "nodes.plans watch_plan",
        'si("Limit.Amplitude trip")', 'si("Limit.Amplitude trip") * 1.001',
        "bound vibration", _RUN,
    ),
    Sabotage(
        "a bound does not follow a write", "nodes.plans watch_plan",
        'Ft_max=si("Limit.Lateral force")', "Ft_max=3.0",
        "bound forces", (("put", "Limit.Lateral force", 2900), ("cycles", 2)),
    ),
    Sabotage(
        "a level is that of another limit", "nodes.stimulator_node levels",
        "contact.Fn / plan.Fn_max", "contact.Fn / plan.Ft_max",
        "levels", _RUN,
    ),
    Sabotage(
        "two faults of a cycle are told in the other order", "nodes.publishing Publishing.report",
        "in watchdogs_in(self._reported & ~before)",
        "in reversed(watchdogs_in(self._reported & ~before))",
        "frames",
        (
            ("cycles", 120), ("put", "Limit.Normal force", 100),
            ("put", "Limit.Lateral force", 100), ("cycles", 2),
        ),
    ),
    Sabotage(
        "a fault that was reset is not taken back", "nodes.publishing Publishing.report",
        "self._device.clear_emergency(WATCHDOGS[watchdog].code)", "pass",
        "frames", (("nmt", 0x02, 32), ("cycles", 2), ("recover", 3)),
    ),
    Sabotage(
        "the Message says something else", "nodes.supervisor Supervisor._why_not",
        "write 0, then 1 (arm), then 3 (run)", "write 0, then 1, then 3",
        "refused", (("put", "Controlword", 0), ("put", "Controlword", 3)),
    ),
    Sabotage(
        "the first fault is not kept", "nodes.fault_memory FaultMemory.recall",
        "lines[: len(self._places)]", "lines[1 : len(self._places)]",
        "fault memory", (("nmt", 0x02, 32),),
    ),
    Sabotage(
        "a guard holds that does not", "nodes.supervisor Supervisor._holds",
        "return supervised | Guard.CLEAR\n",
        "return supervised | Guard.CLEAR | Guard.PREPARED\n",
        "frames", _LEAVE,
    ),
    Sabotage(
        "an integrator does not begin at the drive", "control.step _preset",
        "Loops(voltage,", "Loops(0.0,",
        "control voltage integrator",
        (("put", "Mode", 1), ("cycles", 5), ("put", "Mode", 3), *_RUN),
    ),
    Sabotage(
        "a swap of the plan resets an integrator", "control.cascade adopted",
        "    return state\n", "    return state._replace(loops=Loops(0.0, held, held, False))\n",
        "frames", (("put", "Limit.Voltage", 14_000), ("cycles", 2)),
    ),
    Sabotage(
        "a write is taken over a cycle late", "nodes.stimulator_block StimulatorBlock._prepare",
        "if self._changed:", "if self._changed and self._changed != {'Limit'}:",
        "bound drive", (("put", "Limit.Voltage", 14_000), ("cycles", 2)),
    ),
    Sabotage(
        "a reset keeps a plan", "nodes.stimulator_block StimulatorBlock.start_run",
        "supervisor.plan = plans.watch", "pass",
        "bound forces", (("put", "Limit.Lateral force", 2900), ("cycles", 2), *_RESET),
    ),
    Sabotage(
        "the zero of the gauges outlives a reset", "nodes.taring Taring.begin",
        "self.restore(cascade)", "self._awaited and self.restore(cascade)",
        "control zero",
        (
            ("put", "Controlword", 0), ("put", "Tare at power-on", 0), ("store", 32, 1, SAVE),
            *_RESET,
        ),
    ),
    Sabotage(
        "a tick is answered twice", "nodes.pairing Pairing.take",
        "or tick == self._answered", "or tick is None",
        "", (("echo", "measurement"),),
    ),
    Sabotage(
        "a measurement with a wrong check is answered", "nodes.pairing Pairing.take",
        "if not holds(data)", "if not data",
        "bus", (("disturb", "CORRUPTION", "measurement", 1), ("cycles", 2)),
    ),
    Sabotage(
        "the drive answers another tick", "nodes.drive_output DriveOutput.write",
        "self._tick.value = tick", "self._tick.value = tick ^ 1",
        "frames", (),
    ),
    Sabotage(
        "a late answer counts twice", "nodes.bus_loop LateAnswers._is_late",
        "self._in_a_row += 1", "self._in_a_row += 2",
        "bus late", (("disturb", "DELAY", "measurement", 3), ("cycles", 3)),
        Setting(lockstep=True),
    ),
    Sabotage(
        "a SYNC is owed two answers", "nodes.bus_loop SourceWatch.sync",
        "min(self._credits + 1, deadline.ms)", "min(self._credits + 2, deadline.ms)",
        "bus credits", (),
    ),
    Sabotage(
        "a window of SYNC begins a tick later", "nodes.bus_loop _Window.begin",
        "self._begun = self._clock.now", "self._begun = self._clock.now + 1",
        "bus sync", (),
    ),
    Sabotage(
        "who was seen is remembered over a reset", "nodes.commander Commander.restart",
        "self._seen.clear()", "pass",
        "masters seen", (("nmt", 0x82, 32),),
    ),
    Sabotage(
        "a cycle that was missed is not", "nodes.loop_time MissedTime.cycle",
        "self._cycles += 1", "self._cycles += 2",
        "missed time", (),
    ),
    Sabotage(
        "the plate takes a second drive of a tick", "nodes.plate_block PlateBlock.take_drive",
        "if self._answered or not", "if not",
        "", (("disturb", "DUPLICATION", "drive", 2), ("cycles", 3)),
    ),
    Sabotage(
        "a plate that tripped waits as at first", "nodes.plate_block PlateBlock.inhibit",
        "StageEvent.INHIBIT", "StageEvent.LATCHED",
        "frames", (("disturb", "LOSS", "drive", 6), ("cycles", 6)),
    ),
    Sabotage(
        "a session has the number of the one before", "nodes.plate_node PlateNode.on_state",
        "self._next_session + 1", "self._next_session + 0",
        "next session", (),
    ),
    Sabotage(
        "a wrong check counts for less", "nodes.drive_sender DriveSender.sound",
        "self._count(True)", "self._count(False)",
        "", (("disturb", "CORRUPTION", "drive", 3), ("cycles", 4)),
    ),
    Sabotage(
        "a reading of the stage is compared with now alone",
        "nodes.hardware_watch HardwareWatch.hear",
        "(commanded, *self._commanded)", "(commanded,)",
        "",
        (
            ("put", "Controlword", 0), ("connect_hardware", 1, 20), ("cycles", 2), ("drive", 1),
            ("cycles", 8),
        ),
    ),
    Sabotage(
        "a sample of the tare is written twice", "control.tribometer Nulls.add",
        "(self._head + 1) % TARE_SAMPLES", "(self._head + 2) % TARE_SAMPLES",
        "control oldest sample", (),
    ),
    Sabotage(
        "the plate is warmed by a millionth more", "plant.motion _moved",
        "(target - temperature) * warming", "(target - temperature) * warming * 1.000001",
        "plate state", (),
    ),
    Sabotage(
        "a front end is believed a cycle sooner", "nodes.front_end FrontEnd._doubt",
        "self._sound_missing = SOUND_CYCLES", "self._sound_missing = SOUND_CYCLES - 1",
        "front end", (("front_end", "fails"), ("cycles", 2)), Setting("hardware"),
    ),
    Sabotage(
        "a cycle raises", "nodes.read_back ReadBack.publish",
        "if saturation:", "if saturation or 1 / (voltage <= 0.0) > 1:",
        "error", (),
    ),
)  # fmt: skip
"""What is broken."""


@contextmanager
def broken(package: Package, sabotage: Sabotage) -> Iterator[None]:
    """Break one thing of a package, for as long as the block lasts.

    Raises
    ------
    ValueError
        If what is to be broken is not there once.
    """
    path, _, name = sabotage.place.partition(" ")
    owner: Any = package.module(path)
    *inside, last = name.split(".")
    for part in inside:
        owner = getattr(owner, part)
    function = inspect.unwrap(getattr(owner, last))
    source = textwrap.dedent(inspect.getsource(function))
    if source.count(sabotage.sound) != 1:
        raise ValueError(f"{sabotage.place} has not once {sabotage.sound!r}")
    made: dict[str, Any] = {}
    code = source.replace(sabotage.sound, sabotage.broken)
    exec(compile(code, function.__code__.co_filename, "exec"), function.__globals__, made)
    with patch.object(owner, last, made[last]):
        yield
