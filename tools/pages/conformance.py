"""Fill docs/reference/conformance.md and verdicts.json: every case, on our device and two others.

    tools/pages/make conformance [--check]

Each device is built from tests/eds/rich.eds. Ours runs in device time, python-canopen's LocalNode
and durand (`pip install durand`) in real time over python-can's virtual bus; ten minutes in all.

Example: tools/pages/make conformance --check
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from importlib.metadata import version
from io import StringIO
from itertools import groupby
from pathlib import Path
from threading import Thread
from typing import Any

import can
import canopen
import durand
from durand.scheduler import AsyncScheduler
from pages import REFERENCE, Pages, made, renewed

from smarttac_can.canopen.conformance.case import DeviceDescription, Result
from smarttac_can.canopen.conformance.examiner import Examiner
from smarttac_can.canopen.conformance.refusals import REFUSALS
from smarttac_can.canopen.conformance.run import CASES, GROUPS, DeviceTimeBus, run_cases
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.canopen.od.object_reference import table
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.instrument.nodes.device_node import DeviceNode

ROOT = Path(__file__).resolve().parents[2]
EDS = ROOT / "tests" / "eds" / "rich.eds"
NODE_ID = 5
TIME_OUT_S = 0.5
FRAMES = 4
"""Last frames of a failed case that the data keep."""
NOT_RUN = ("CANopenNode", "lely-core", "gocanopen")
"""Stacks that have to be built first; 'smarttac conform' judges a device of them on any bus."""


def ours(text: str) -> list[Result]:
    """Judge the device of this package in device time."""
    bus = DeviceTimeBus(DeviceNode(Device(load_eds(text, NODE_ID))))
    return run_cases(Examiner(bus, DeviceDescription(text, NODE_ID), clock=bus.time), CASES)


def over_virtual_bus(text: str, channel: str) -> list[Result]:
    """Judge the node on a channel of the virtual bus."""
    with closing(PythonCanBus("virtual", channel)) as bus:
        return run_cases(Examiner(bus, DeviceDescription(text, NODE_ID), timeout=TIME_OUT_S), CASES)


def python_canopen(text: str) -> list[Result]:
    """Judge a LocalNode of python-canopen."""
    network = canopen.Network()
    network.connect(interface="virtual", channel="canopen")
    file = StringIO(text)
    file.name = EDS.name
    node = network.create_node(NODE_ID, file)
    node.nmt.send_command(0)
    node.nmt.state = "PRE-OPERATIONAL"
    try:
        return over_virtual_bus(text, "canopen")
    finally:
        network.disconnect()


def with_durand(text: str) -> list[Result]:
    """Judge a node of durand with the same objects, run by an event loop as its timers ask for."""
    loop = asyncio.new_event_loop()
    thread = Thread(target=loop.run_forever)
    thread.start()
    try:
        node = asyncio.run_coroutine_threadsafe(_durand_node(text, loop), loop).result()
        results = over_virtual_bus(text, "durand")
        node.network.stop()
        return results
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()


async def _durand_node(text: str, loop: asyncio.AbstractEventLoop) -> durand.Node:
    durand.set_scheduler(AsyncScheduler(loop))
    bus = can.Bus(interface="virtual", channel="durand")
    node = durand.MinimalNode(durand.CANBusNetwork(bus, loop), NODE_ID)
    od = load_eds(text, NODE_ID)
    for index, item in od.objects.items():
        if index > cia.COMMUNICATION_LAST:
            variables = {n: v for n, e in item.entries.items() if (v := _variable(e)) is not None}
            if set(item.entries) == {0}:
                if variables:
                    node.object_dictionary[index] = variables[0]
                continue
            record = durand.Record(name=item.name)
            for subindex, variable in variables.items():
                if subindex:
                    record[subindex] = variable
            node.object_dictionary[index] = record
    for index, subindex in ((cia.DEVICE_TYPE, 0), *((cia.IDENTITY, n) for n in range(1, 5))):
        node.object_dictionary.write(index, subindex, od.number(index, subindex))
    for index in (cia.DEVICE_NAME, cia.HARDWARE_VERSION, cia.SOFTWARE_VERSION):
        if (entry := od.get(index)) is not None:
            node.object_dictionary.write(index, 0, entry.pack())
    node.object_dictionary.write(cia.HEARTBEAT_PRODUCER, 0, od.number(cia.HEARTBEAT_PRODUCER))
    _map(node.tpdo, od, cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING)
    _map(node.rpdo, od, cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING)
    return node


def _variable(entry: Entry) -> durand.Variable | None:
    if entry.data_type not in list(durand.DatatypeEnum):
        return None
    numeric = isinstance(entry.value, int | float) and entry.high > entry.low
    access = {"rww": "rw", "rwr": "rw"}.get(entry.access, entry.access)
    value = entry.value if isinstance(entry.value, int | float) else entry.pack()
    limits = (entry.low, entry.high) if numeric else (None, None)
    kind = durand.DatatypeEnum(entry.data_type)
    return durand.Variable(
        kind, access, value, minimum=limits[0], maximum=limits[1], name=entry.name
    )


def _map(pdos: list[Any], od: ObjectDictionary, communication: int, mapping: int) -> None:
    for n, pdo in enumerate(pdos):
        entries = [od.number(mapping + n, s + 1) for s in range(od.number(mapping + n))]
        try:
            pdo.mapping = [(value >> 16, value >> 8 & 0xFF) for value in entries]
            pdo.transmission_type = od.number(communication + n, cia.PDO_TRANSMISSION)
        except (KeyError, ValueError, TypeError) as error:
            print(f"durand takes no PDO {communication + n:04X}h: {error!r}")


DEVICES: dict[str, Callable[[str], list[Result]]] = {
    "`smarttac device`": ours,
    f"python-canopen {version('canopen')}, `LocalNode`": python_canopen,
    f"durand {version('durand')}, `MinimalNode`": with_durand,
}
MARKS = {"pass": "", "fail": " fails", "not applicable": " n/a"}


def fields(columns: dict[str, list[Result]]) -> dict[str, str | Iterable[str]]:
    """Return the fields of the page."""
    rows = []
    for letter, (name, results) in zip("ABC", columns.items(), strict=True):
        counts = Counter(result.verdict for result in results)
        rows.append((letter, name, *(str(counts[mark]) for mark in MARKS)))
    head = ("", "device", "pass", "fail", "not applicable")
    return {
        "count": str(len(CASES)),
        "rows": table(head, *rows),
        "refusals": refusal_table(),
        "cases": case_tables(columns),
    }


def refusal_table() -> Iterator[str]:
    """Return the refusals of a device, and their abort codes."""
    head = ("Request", "Cases", "Accepted abort codes", "By")
    rows = [
        (row.what, row.cases, ", ".join(f"{code:08X}h" for code in row.codes), row.source)
        for row in REFUSALS
    ]
    yield from table(head, *rows)


def case_tables(columns: dict[str, list[Result]]) -> Iterator[str]:
    """Return the cases of each group, and the devices that did not pass them."""
    lines = zip(CASES, *columns.values(), strict=True)
    for group, cases in groupby(lines, key=lambda line: line[0].group):
        rows = []
        for case, *results in cases:
            marks = [
                letter + MARKS[result.verdict]
                for letter, result in zip("ABC", results, strict=True)
                if result.verdict != "pass"
            ]
            lacks = ", ".join(marks).replace("B fails, C fails", "B, C fail")
            rows.append((f"{case.number} {case.title}", case.rule, lacks))
        yield from (f"## {GROUPS[group]}", "", *table(("Case", "Rule", "Not passed"), *rows))


def pages(_draw: bool) -> Pages:
    """Judge all devices, and return the page."""
    logging.disable()  # the other devices report each refusal
    text = EDS.read_text(encoding="latin-1")
    with ThreadPoolExecutor() as pool:
        runs = {name: pool.submit(judge, text) for name, judge in DEVICES.items()}
        verdicts = {name: run.result() for name, run in runs.items()}
    page = renewed(REFERENCE / "conformance.md", fields(verdicts))
    return {**page, REFERENCE / "verdicts.json": corpus(verdicts)}


def corpus(columns: dict[str, list[Result]]) -> str:
    """Return what each device did not pass, as JSON: why, by which rule, and the last frames.

    Devices that are only in `NOT_RUN` have no rows: nothing is said about a stack that did not run.
    """
    devices = [
        {
            "device": name.replace("`", ""),
            "eds": EDS.name,
            "cases": len(results),
            "not_passed": [
                {
                    "case": result.case.number,
                    "verdict": result.verdict,
                    "why": result.reason,
                    "rule": result.case.rule,
                    "frames": list(result.trace[-FRAMES:]),
                }
                for result in results
                if result.verdict != "pass"
            ],
        }
        for name, results in columns.items()
    ]
    missing = [{"device": name, "verdict": "not run"} for name in NOT_RUN]
    return json.dumps([*devices, *missing], indent=1) + "\n"


def main() -> int:
    """Write the page, or compare it."""
    return made(__doc__, pages)
