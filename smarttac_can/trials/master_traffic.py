"""A master that does at random what a master may do at any time."""

from __future__ import annotations

import random
from typing import Final

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.master.errors import HeartbeatLostError
from smarttac_can.od.cia import EXPEDITED_BYTES, Abort, NMTCommand
from smarttac_can.trials.rig import Rig
from smarttac_can.vocabulary.modes import Mode

# Ends of the shares of a draw from 0 to 1; above the last one the master does nothing.
_READ: Final = 0.10
_SET_POINT: Final = 0.18
_MODE: Final = 0.22
_COMMAND: Final = 0.28
_START: Final = 0.30
_DELAY: Final = 0.32


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
        self._readable = [
            entry for entry in od if entry.readable and 0 < entry.size <= EXPEDITED_BYTES
        ]

    def send(self) -> None:
        """Send something, or nothing; refusals and silence are the node's good right."""
        draw = self._random
        choice = draw.random()
        rig = self._rig
        try:
            if choice < _READ:
                rig.master.read(STIMULATOR_ID, draw.choice(self._readable))
            elif choice < _SET_POINT:
                entry = draw.choice(self._setpoints)
                raw = draw.randint(int(entry.low), int(entry.high))
                rig.master.write(STIMULATOR_ID, entry, raw)
            elif choice < _MODE:
                rig.write("Mode", draw.choice(tuple(Mode)))
            elif choice < _COMMAND and self._commands:
                rig.write("Controlword", draw.choice((0, 1, 3, 1, 3, 4, 7)))
            elif choice < _START:
                rig.nmt(NMTCommand.START, draw.choice((0, STIMULATOR_ID, PLATE_ID)))
            elif choice < _DELAY:
                rig.write("Fault.Delay in cycles", draw.randrange(10))
        except (Abort, HeartbeatLostError):
            return
