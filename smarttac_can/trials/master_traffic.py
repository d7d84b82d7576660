"""A master that does at random what a master may do at any time."""

from __future__ import annotations

import random

from smarttac_can.bench.open_link import PLATE_ID, STIMULATOR_ID
from smarttac_can.control.cascade import Mode
from smarttac_can.master.errors import HeartbeatLostError
from smarttac_can.od.cia import Abort, NMTCommand
from smarttac_can.trials.rig import Rig


class MasterTraffic:
    """What a master may do at any time without resetting a fault: reads, writes, commands, RPDOs.

    Parameters
    ----------
    rig
        Its nodes get it.
    seed
        Of what is sent.
    commands
        Whether it also arms, runs and stops.
    """

    def __init__(self, rig: Rig, seed: int, *, commands: bool = True) -> None:
        self._commands = commands
        self._rig = rig
        self._random = random.Random(seed)
        od = rig.od
        self._setpoints = [entry for entry in od if entry.name.startswith("Setpoint.")]
        self._readable = [entry for entry in od if entry.readable and 0 < entry.size <= 4]

    def send(self) -> None:
        """Send something, or nothing; refusals and silence are the node's good right."""
        draw = self._random
        choice = draw.random()
        rig = self._rig
        try:
            if choice < 0.10:
                rig.master.read(STIMULATOR_ID, draw.choice(self._readable))
            elif choice < 0.18:
                entry = draw.choice(self._setpoints)
                raw = draw.randint(int(entry.low), int(entry.high))
                rig.master.write(STIMULATOR_ID, entry, raw)
            elif choice < 0.22:
                rig.write("Mode", draw.choice(tuple(Mode)))
            elif choice < 0.28 and self._commands:
                rig.write("Controlword", draw.choice((0, 1, 3, 1, 3, 4, 7)))
            elif choice < 0.30:
                rig.nmt(NMTCommand.START, draw.choice((0, STIMULATOR_ID, PLATE_ID)))
            elif choice < 0.32:
                rig.write("Fault.Delay in cycles", draw.randrange(10))
        except (Abort, HeartbeatLostError):
            return
