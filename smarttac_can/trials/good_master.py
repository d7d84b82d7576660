"""A master that does its duty: it drives the pair again and again, whatever others do."""

from __future__ import annotations

import random
from typing import Final

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.device.nmt import NMTState
from smarttac_can.master import requests
from smarttac_can.master.errors import HeartbeatLostError
from smarttac_can.od.cia import (
    ERROR_FIELD,
    EXPEDITED_BYTES,
    MANUFACTURER_FIRST,
    Abort,
    AbortCode,
    NMTCommand,
)
from smarttac_can.od.entry import Entry
from smarttac_can.trials.fault_case import REGULATED
from smarttac_can.trials.rig import Rig
from smarttac_can.vocabulary.modes import Law, VibrationLaw
from smarttac_can.vocabulary.states import State

REST_CYCLES: Final = 100
"""Cycles at 0 V before a fault is reset, and between two looks at the pair."""
_LOOK_CYCLES: Final = 10
_FINGER_MN: Final = 500
_NO_SETTING: Final = ("Simulation", "Fault", "AI auto-zero")
_DRAWN: Final = {
    "Setpoint.Voltage": (1000, 5000),
    "Setpoint.Frequency": (4_334_000, 4_344_000),
    "Setpoint.Amplitude": (300, 1800),
    "Setpoint.COF left": (2500, 6000),
    "Setpoint.COF right": (2500, 6000),
    "Friction law": (min(Law), max(Law)),
    "Controller.Vibration law": (min(VibrationLaw), max(VibrationLaw)),
}
"""What is drawn for each run, laws as well."""


class GoodMaster:
    """Arms again after a disarm, and resets a fault when 0 V was held for 100 cycles.

    Before it arms it sees to it that both nodes are configured as they were at first: what somebody
    has changed of the communication is put right by NMT reset communication, the rest by SDO.

    Parameters
    ----------
    rig
        Its pair, started.
    draw
        Of modes, laws and set-points.

    Attributes
    ----------
    resets, arms, repairs
        How many faults it has reset, how often it has armed, how many objects it has put right.
    """

    def __init__(self, rig: Rig, draw: random.Random) -> None:
        self._rig = rig
        self._draw = draw
        self._at_zero = 0
        self.resets = self.arms = self.repairs = 0
        self._nodes = ((STIMULATOR_ID, rig.stimulator), (PLATE_ID, rig.plate))
        rig.start_run(force_mN=_FINGER_MN)
        self._settings = [
            (node_id, entry, entry.read())
            for node_id, node in self._nodes
            for entry in node.od
            if _is_setting(entry)
        ]

    def act(self) -> None:
        """Look at the pair after a cycle, and do what is due."""
        rig = self._rig
        self._at_zero = 0 if rig.stage.read() else self._at_zero + 1
        if rig.cycles % _LOOK_CYCLES:
            return
        state = rig.state
        try:
            if state is State.FAULT:
                if self._at_zero >= REST_CYCLES and rig.cycles % REST_CYCLES == 0:
                    self._repair()
                    rig.reset_fault()
                    self.resets += rig.state is not State.FAULT
            elif state is not State.RUNNING:
                self._drive()
            elif not rig.od["Mode"].value:
                rig.write("Mode", self._draw.choice(REGULATED))
        except Abort:
            # Not ready yet, or somebody was faster: there is a next time.
            return
        except HeartbeatLostError:
            self.abort_transfers()

    def disarm(self) -> None:
        """Let the next look configure both nodes and arm anew."""
        self._rig.write("Controlword", 0)

    def abort_transfers(self) -> None:
        """End transfers that are left open: a block download takes all requests for segments."""
        for node_id, _ in self._nodes:
            self._rig.master.send(requests.abort(node_id, AbortCode.TIME_OUT))

    def _drive(self) -> None:
        rig, draw = self._rig, self._draw
        self._repair()
        rig.write("Controlword", 0)
        for name, (low, high) in _DRAWN.items():
            rig.write(name, draw.randint(low, high))
        rig.drive(draw.choice(REGULATED))
        self.arms += 1

    def _repair(self) -> None:
        """Have both nodes OPERATIONAL and configured.

        What can be put right is, also after a refusal: a weight on the plate may be why a node
        refuses something.

        Raises
        ------
        Abort
            The first refusal.
        """
        rig = self._rig
        wrong = [
            (node_id, entry, raw) for node_id, entry, raw in self._settings if entry.read() != raw
        ]
        self.repairs += len(wrong)
        for node_id in {node_id for node_id, entry, _ in wrong if entry.index < MANUFACTURER_FIRST}:
            rig.nmt(NMTCommand.RESET_COMMUNICATION, node_id)
        if any(node.device.nmt_state is not NMTState.OPERATIONAL for _, node in self._nodes):
            rig.nmt(NMTCommand.START)
            rig.configure()
        refused: Abort | None = None
        for node_id, entry, raw in wrong:
            if entry.index >= MANUFACTURER_FIRST:
                try:
                    rig.master.write(node_id, entry, raw)
                except Abort as abort:
                    refused = refused or abort
        if refused is not None:
            raise refused
        if any(entry.name.startswith("Finger.") for _, entry, _ in wrong):
            rig.start_run(force_mN=_FINGER_MN)


def _is_setting(entry: Entry) -> bool:
    """Tell whether an entry configures a node; what RPDOs bring or a run draws does not."""
    named = entry.name.partition(".")[0] in _NO_SETTING
    return (
        entry.access == "rw"
        and 0 < entry.size <= EXPEDITED_BYTES
        and entry.index != ERROR_FIELD
        and entry.name not in _DRAWN
        and not named
    )
