"""What a stimulator says of itself: NMT state, faults, commander and levels, by reading alone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import canopen

from smarttac_can.bench.remote_device import RemoteDevice, bench_id
from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.canopen.commissioning.node_ids import wait_until
from smarttac_can.canopen.device.error_control import supervised_node
from smarttac_can.canopen.device.nmt import UNKNOWN, state_text
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.canopen.od import cia
from smarttac_can.vocabulary.signals import MEASUREMENT_RPDOS
from smarttac_can.vocabulary.states import Mode, Status, known_state
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, level, watchdogs_in

_HEARTBEATS_WAITED: Final = 1.5
_LONGEST_WATCH_S: Final = 2.0
_STATUS: Final = sum(Status)
_LEVELS: Final = (
    ("voltage", "Vibration.Voltage", "Limit.Voltage", "V"),
    ("amplitude", "Vibration.Amplitude", "Limit.Amplitude trip", "um"),
    ("temperature", "Plate temperature", "Limit.Temperature", "degC"),
    ("normal force", "Contact.Normal force", "Limit.Normal force", "N"),
    ("lateral force", "Contact.Tangential force", "Limit.Lateral force", "N"),
)
"""Measured values: their names here and in the object dictionary, with the limit of a fault."""


class Supervised(NamedTuple):
    """A node whose heartbeat a stimulator supervises."""

    node_id: int
    entry: int
    """Sub-index of its entry in the heartbeat consumer."""
    bench: bool
    """Whether it is the entry of bench scripts."""
    seconds: float
    """Consumer heartbeat time in s."""
    heard: bool = False


def read_status(
    network: canopen.Network,
    node_id: int,
    *,
    plate_node_id: int | None = None,
    where: str = "the bus",
    timeout: float = 1.0,
) -> dict[str, Any]:
    """Read how a stimulator is; no node is started, and a running drive goes on.

    Parameters
    ----------
    network
        Connected network of python-canopen.
    node_id
        Node-ID of the stimulator.
    plate_node_id
        Node-ID of its plate; that to which the stimulator is linked unless given.
    where
        Name of the bus in the result and in error messages.
    timeout
        Longest wait for an SDO answer in s.

    Returns
    -------
    dict
        State, mode, flags, message, faults that are latched and present, levels with their limits,
        NMT states, and who drives it; only numbers, texts, lists and dicts, as for JSON.

    Raises
    ------
    BenchError
        If a node does not answer, or is another device.
    """
    device = RemoteDevice(network, stimulator_od(node_id), where, timeout)
    plate_id = plate_node_id or plate_of(device)
    plate = None if plate_id is None else RemoteDevice(network, plate_od(plate_id), where, timeout)
    return {
        "bus": where,
        "node_id": node_id,
        "nmt": _nmt(device),
        "plate": None if plate is None else {"node_id": plate_id, "nmt": _nmt(plate)},
        **_state(device),
        "levels": _levels(device),
        "driven_by": [
            {"node_id": watch.node_id, "bench": watch.bench, "heard": watch.heard}
            for watch in supervised(network, device, plate_id)
        ],
    }


def plate_of(device: RemoteDevice) -> int | None:
    """Return the node-ID of the plate to which a stimulator is linked; None if it is inside."""
    first = cia.RPDO_COMMUNICATION + MEASUREMENT_RPDOS[0] - 1
    cob_id = int(device.read(device.od.entry(first, cia.PDO_COB_ID)))
    plate = (cob_id & cia.CAN_ID_MASK) - cia.TPDO_IDS[0]
    return plate if not cob_id & cia.COB_INVALID and 1 <= plate <= cia.CAN_ID_MASK >> 4 else None


def supervised(
    network: canopen.Network, device: RemoteDevice, plate_id: int | None
) -> list[Supervised]:
    """Return the nodes that a stimulator supervises besides its plate, and listen for each."""
    heard: set[int] = set()

    def hear(can_id: int, _data: bytearray, _timestamp: float) -> None:
        heard.add(can_id - cia.HEARTBEAT_ID)

    watches = [watch for watch in _entered(device) if watch.node_id != plate_id]
    for watch in watches:
        network.subscribe(cia.HEARTBEAT_ID + watch.node_id, hear)
    longest = max((watch.seconds for watch in watches), default=0.0)
    wait_until(
        lambda: heard.issuperset(watch.node_id for watch in watches),
        min(longest, _LONGEST_WATCH_S),
    )
    return [watch._replace(heard=watch.node_id in heard) for watch in watches]


def _entered(device: RemoteDevice) -> Iterator[Supervised]:
    own = device.od.node_id
    for subindex, entry in device.od.objects[cia.HEARTBEAT_CONSUMER].entries.items():
        if subindex:
            value = int(device.read(entry))
            if node_id := supervised_node(value):
                is_bench = node_id == bench_id(own)
                yield Supervised(node_id, subindex, is_bench, (value & 0xFFFF) * 1e-3)


def _nmt(device: RemoteDevice) -> str:
    # 0 before the first heartbeat, and after a boot-up: the next heartbeat has the state entered.
    wait_until(lambda: device.state != 0, _HEARTBEATS_WAITED * device.heartbeat_s)
    state = device.state
    return state_text(state) if state else UNKNOWN


def _state(device: RemoteDevice) -> dict[str, Any]:
    od = device.od
    word = int(device.read(od["Statusword"]))
    state = known_state(word)
    if state is None:
        raise BenchError(f"node {od.node_id} has a statusword of {word:04X}h, which no state has")
    return {
        "state": state.name.lower(),
        "mode": Mode(device.read(od["Mode display"])).name.lower(),
        "flags": [bit.name.lower() for bit in Status(word & _STATUS) if bit.name],
        "message": str(device.read(od["Message"])),
        "latched": _faults(device, "Diagnosis.Latched"),
        "present": _faults(device, "Diagnosis.Present"),
    }


def _faults(device: RemoteDevice, name: str) -> list[dict[str, Any]]:
    watchdogs = watchdogs_in(int(device.read(device.od[name])))
    rows = [WATCHDOGS[watchdog] for watchdog in watchdogs]
    return [{"code": int(row.code), "text": row.text, "remedy": row.remedy} for row in rows]


def _levels(device: RemoteDevice) -> dict[str, Any]:
    def number(name: str, unit: str) -> float:
        entry = device.od[name]
        return float(entry.unit.times(device.read(entry), unit))

    levels = {}
    for name, measured, bound, unit in _LEVELS:
        value, limit = number(measured, unit), number(bound, unit)
        share = round(level(abs(value), limit), 3) if limit else None
        levels[name] = {"value": value, "limit": limit, "unit": unit, "level": share}
    return levels
