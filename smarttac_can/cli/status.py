"""The commands that ask a stimulator how it is, and reset its fault: ``status`` and ``reset``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import canopen
import click

from smarttac_can.bench import FaultError, State, Stimulator, plate_od, stimulator_od
from smarttac_can.bench.remote_device import RemoteDevice, bench_id
from smarttac_can.cli.options import (
    BusChoice,
    closing_network,
    stimulator_options,
    timeout_option,
)
from smarttac_can.cli.plain_errors import one_line, plain_errors
from smarttac_can.cli.process import lockstep_option
from smarttac_can.cli.result_file import (
    force_option,
    json_option,
    opened_results,
    report_results,
)
from smarttac_can.commissioning.node_ids import wait_until
from smarttac_can.commissioning.scan import STATES, UNKNOWN
from smarttac_can.master.errors import BenchError
from smarttac_can.nodes.lock import watched_node
from smarttac_can.nodes.loop_frames import MEASUREMENT_RPDOS
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_INVALID,
    HEARTBEAT_CONSUMER,
    HEARTBEAT_ID,
    PDO_COB_ID,
    RPDO_COMMUNICATION,
    TPDO_IDS,
)
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import Status, known_state
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog, level, watchdogs_in

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
"""What is measured, by its name here and there, with the limit at which it is a fault."""


class _Watch(NamedTuple):
    """A node whose heartbeat a stimulator watches."""

    node_id: int
    entry: int
    """Sub-index of its entry."""
    bench: bool
    """Whether it is that of bench scripts."""
    seconds: float
    """How long it may be silent."""
    heard: bool = False


@click.command(
    epilog="\b\nExamples:\n  smarttac status --interface socketcan --channel can0\n"
    "  smarttac status --interface socketcan --channel can0 --json | jq .state"
)
@stimulator_options
@timeout_option
@json_option
@force_option()
def status(
    *,
    bus: BusChoice,
    node_id: int,
    plate_node: int | None,
    timeout: float,
    json_file: Path | None,
) -> None:
    """Say how a stimulator is: NMT, state, faults, message, who drives, how near its limits it is.

    It only asks: nothing is started, and whoever drives goes on. The exit code is 0 also for a
    stimulator in FAULT.
    """
    with plain_errors(), ExitStack() as stack:
        results = opened_results(stack, json_file)
        with closing_network(bus) as network:
            said = _ask(network, bus.where, node_id, plate_node, timeout)
        report_results(said, _lines(said), results)


@click.command(epilog="\b\nExample:\n  smarttac reset --interface socketcan --channel can0")
@stimulator_options
@timeout_option
@lockstep_option
def reset(
    *, bus: BusChoice, node_id: int, plate_node: int | None, timeout: float, lockstep: bool
) -> None:
    """Reset the latched fault of a stimulator; 1 if its cause is still there.

    It starts the nodes, and is refused while another bench drives. Without a fault nothing is done.
    """
    with (
        plain_errors(),
        _cure_of_silence(bus, node_id, plate_node, timeout),
        Stimulator.connect(
            node_id=node_id,
            plate_node_id=plate_node,
            timeout=timeout,
            lockstep=lockstep,
            **bus.options,
        ) as stimulator,
    ):
        state = stimulator.state
        if state is not State.FAULT:
            click.echo(f"stimulator {node_id} has no fault: its state is {_plain(state)}")
            return
        why = stimulator.message
        stimulator.reset_fault()
        click.echo(one_line(f"stimulator {node_id} is reset ({why}): {_plain(stimulator.state)}"))


@contextmanager
def _cure_of_silence(
    bus: BusChoice, node_id: int, plate_node: int | None, timeout: float
) -> Iterator[None]:
    """Name the node whose lost heartbeat refuses a reset, and what to do, in the error's notes."""
    try:
        yield
    except FaultError as error:
        if WATCHDOGS[Watchdog.HEARTBEAT].text in str(error):
            with closing_network(bus) as network:
                device = RemoteDevice(network, stimulator_od(node_id), bus.where, timeout)
                for watch in _watches(network, device, plate_node or _plate_of(device)):
                    if not watch.heard:
                        error.add_note(
                            f"node {watch.node_id} is watched but not heard: start it again, or "
                            f"write 0 to {HEARTBEAT_CONSUMER:X}h sub-index {watch.entry} of node "
                            f"{node_id}, or reset node {node_id} (NMT)"
                        )
        raise


def _plain(state: State) -> str:
    return state.name.lower().replace("_", " ")


def _ask(
    network: canopen.Network, where: str, node_id: int, plate_node: int | None, timeout: float
) -> dict[str, Any]:
    """Ask a stimulator, and listen for the heartbeats of those that it watches."""
    device = RemoteDevice(network, stimulator_od(node_id), where, timeout)
    plate_id = plate_node or _plate_of(device)
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
            for watch in _watches(network, device, plate_id)
        ],
    }


def _plate_of(device: RemoteDevice) -> int | None:
    """Return the node-ID of the plate that a stimulator is linked to; None if it is inside."""
    first = RPDO_COMMUNICATION + MEASUREMENT_RPDOS[0] - 1
    cob_id = int(device.read(device.od.entry(first, PDO_COB_ID)))
    plate = (cob_id & CAN_ID_MASK) - TPDO_IDS[0]
    return plate if not cob_id & COB_INVALID and 1 <= plate <= CAN_ID_MASK >> 4 else None


def _watches(network: canopen.Network, device: RemoteDevice, plate_id: int | None) -> list[_Watch]:
    """Return the nodes that a stimulator watches beside its plate, and listen for each of them."""
    heard: set[int] = set()

    def hear(can_id: int, _data: bytearray, _timestamp: float) -> None:
        heard.add(can_id - HEARTBEAT_ID)

    watches = [watch for watch in _entered(device) if watch.node_id != plate_id]
    for watch in watches:
        network.subscribe(HEARTBEAT_ID + watch.node_id, hear)
    longest = max((watch.seconds for watch in watches), default=0.0)
    wait_until(
        lambda: heard.issuperset(watch.node_id for watch in watches),
        min(longest, _LONGEST_WATCH_S),
    )
    return [watch._replace(heard=watch.node_id in heard) for watch in watches]


def _entered(device: RemoteDevice) -> Iterator[_Watch]:
    own = device.od.node_id
    for subindex, entry in device.od.objects[HEARTBEAT_CONSUMER].entries.items():
        if subindex:
            value = int(device.read(entry))
            if node_id := watched_node(value):
                is_bench = node_id == bench_id(own)
                yield _Watch(node_id, subindex, is_bench, (value & 0xFFFF) * 1e-3)


def _nmt(device: RemoteDevice) -> str:
    """Wait for a heartbeat, and return the NMT state in it."""
    wait_until(lambda: device.heartbeat_at is not None, _HEARTBEATS_WAITED * device.heartbeat_s)
    return STATES.get(device.state, UNKNOWN) if device.heartbeat_at is not None else UNKNOWN


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
    return [{"code": int(WATCHDOGS[w].code), "text": WATCHDOGS[w].text} for w in watchdogs]


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


def _lines(said: dict[str, Any]) -> Iterator[str]:
    plate = said["plate"]
    nodes = [f"stimulator {said['node_id']} {_heard(said['nmt'])}"]
    if plate is not None:
        nodes.append(f"plate {plate['node_id']} {_heard(plate['nmt'])}")
    yield _line("nodes", f"{', '.join(nodes)}, on {said['bus']}")
    flags = f" ({', '.join(said['flags'])})" if said["flags"] else ""
    yield _line("state", f"{said['state'].replace('_', ' ')}, mode {said['mode']}{flags}")
    for fault in said["latched"]:
        gone = "" if fault in said["present"] else "; no longer present: smarttac reset"
        yield _line("fault", f"{fault['code']:04X}h {fault['text']}{gone}")
    for fault in said["present"]:
        if fault not in said["latched"]:
            yield _line("present", f"{fault['code']:04X}h {fault['text']}, not latched")
    if said["message"]:
        yield _line("message", said["message"])
    yield _line("driven by", _drivers(said))
    if "live" not in said["flags"]:
        yield _line("no cycle comes", "what follows is of the last one, or of none")
    for name, now in said["levels"].items():
        share = "" if now["level"] is None else f", {now['level']:.0%}"
        yield _line(name, f"{now['value']:g} of {now['limit']:g} {now['unit']}{share}")


def _heard(nmt: str) -> str:
    return "in a state that no heartbeat tells" if nmt == UNKNOWN else nmt


def _line(name: str, text: str) -> str:
    return f"{name:<15}{one_line(text)}"


def _drivers(said: dict[str, Any]) -> str:
    there = [
        f"{'a bench script' if who['bench'] else 'a master'}, heartbeat of node {who['node_id']}"
        for who in said["driven_by"]
        if who["heard"]
    ]
    silent = [str(who["node_id"]) for who in said["driven_by"] if not who["heard"]]
    if not there:
        drives = said["state"] in ("armed", "running")
        there = ["somebody whose heartbeat is not watched" if drives else "nobody"]
    if silent:
        there.append(f"node {' and '.join(silent)} watched but not heard")
    return "; ".join(there)
