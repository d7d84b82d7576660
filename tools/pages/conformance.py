"""Fill docs/reference/conformance.md and verdicts.json: every case, on our device and on others.

    tools/pages/make conformance [--check]
    tools/pages/make conformance --stack NAME --eds FILE --node-id N --command LINE

Three devices are built from tests/eds/rich.eds. Ours runs in device time, python-canopen's
LocalNode and durand (`pip install durand`) in real time over python-can's virtual bus. Then come
the scripted devices of tests/faulty_devices.py; twenty minutes in all.

--stack judges a device of another stack instead, which you have built; the verdicts on the others
stay. NAME begins with the name of the stack in the table, and gives the version. The command line
starts a node on the bus. It is started again if it ends, as some nodes do on reset node.

Example: tools/with-vcan -- tools/pages/make conformance --stack "CANopenNode 4.0"
    --eds demoDevice.eds --node-id 5 --command "./demoLinuxDevice vcan0 -i 5"
"""

from __future__ import annotations

import asyncio
import json
import logging
import shlex
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from importlib.metadata import version
from io import StringIO
from itertools import groupby
from pathlib import Path
from threading import Event, Thread
from typing import Any, Final

import can
import canopen
import durand
from durand.scheduler import AsyncScheduler
from pages import REFERENCE, Pages, differences, parser_of, renewed, write

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
from smarttac_can.host.files import read_eds_file
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.instrument.nodes.device_node import DeviceNode

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests"))  # its scripted devices are data of the page, too
from faulty_devices import FAULTS  # noqa: E402 - found only now

EDS = ROOT / "tests" / "eds" / "rich.eds"
NODE_ID = 5
TIME_OUT_S = 0.5
FRAMES = 4
"""Last frames of a failed case that the data keep."""
BUILT: Final = ("CANopenNode", "lely-core", "gocanopen")
"""Stacks that have to be built first, judged with --stack by those who have."""
VERDICTS = REFERENCE / "verdicts.json"
PAGE = REFERENCE / "conformance.md"
LETTERS = "ABCDEF"
Verdicts = dict[str, Any]
"""Verdicts on one device, as the data keep them."""


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
    "smarttac device": ours,
    f"python-canopen {version('canopen')}, LocalNode": python_canopen,
    f"durand {version('durand')}, MinimalNode": with_durand,
}


# Devices of stacks that somebody has built.


@contextmanager
def started(command: str) -> Iterator[None]:
    """Keep a node running, which is started again whenever it ends."""
    ending = Event()
    nodes: list[subprocess.Popen[bytes]] = []

    def run() -> None:
        while not ending.is_set():
            nodes.append(subprocess.Popen(shlex.split(command), stdout=subprocess.DEVNULL))
            nodes[-1].wait()
            ending.wait(PAUSE_S)

    thread = Thread(target=run)
    thread.start()
    try:
        ending.wait(START_S)
        yield
    finally:
        ending.set()
        nodes[-1].terminate()
        thread.join()


START_S, PAUSE_S = 1.0, 0.05


def judged_stack(options: dict[str, Any]) -> Verdicts:
    """Judge the node that a command line starts on a bus, by its EDS."""
    eds, node_id = Path(options["eds"]), options["node_id"]
    text = read_eds_file(eds)
    with (
        started(options["command"]),
        closing(PythonCanBus(options["interface"], options["channel"])) as bus,
    ):
        examiner = Examiner(bus, DeviceDescription(text, node_id))
        examiner.require_device()
        return as_data(options["stack"], eds.name, run_cases(examiner, CASES))


# The data: what each device did not pass.


def rows(results: Iterable[Result]) -> list[dict[str, Any]]:
    """Return the cases that did not pass: why, by which rule, and the last frames."""
    return [
        {
            "case": result.case.number,
            "verdict": result.verdict,
            "why": result.reason,
            "rule": result.case.rule,
            "frames": list(result.trace[-FRAMES:]),
        }
        for result in results
        if result.verdict != "pass"
    ]


def as_data(name: str, eds: str, results: list[Result]) -> Verdicts:
    """Return the verdicts on a device as data."""
    return {"device": name, "eds": eds, "cases": len(results), "not_passed": rows(results)}


def deviations() -> list[dict[str, Any]]:
    """Judge each scripted device by all cases; raise `ValueError` if it passes one it must fail."""
    found = []
    for name, fault in FAULTS.items():
        results = fault.judge(" ".join(case.number for case in CASES))
        failed = [row for row in rows(results) if row["verdict"] == "fail"]
        by_rule = fault.fails.split()
        if missing := set(by_rule) - {row["case"] for row in failed}:
            raise ValueError(f"the scripted device '{name}' passes {', '.join(sorted(missing))}")
        found.append(
            {
                "scripted_device": name,
                "fails": [row for row in failed if row["case"] in by_rule],
                "fails_too": [
                    {"case": row["case"], "why": row["why"]}
                    for row in failed
                    if row["case"] not in by_rule
                ],
            }
        )
    return found


def all_devices(built: list[Verdicts]) -> list[Verdicts]:
    """Judge the devices of this machine; those that somebody has built stay as they are."""
    text = read_eds_file(EDS)
    with ThreadPoolExecutor() as pool:
        runs = {name: pool.submit(judge, text) for name, judge in DEVICES.items()}
        return [as_data(name, EDS.name, run.result()) for name, run in runs.items()] + built


# The page, which is made of the data alone.


MARKS = {"pass": "", "fail": " fails", "not applicable": " n/a"}


def fields(devices: list[Verdicts], scripted: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the fields of the page."""
    run = [device for device in devices if "cases" in device]
    return {
        "count": str(len(CASES)),
        "rows": device_table(devices),
        "refusals": refusal_table(),
        "answers": answer_table(run[1:]),
        "scripted": str(len(scripted)),
        "cases": case_tables(run, scripted),
    }


def device_table(devices: list[Verdicts]) -> Iterator[str]:
    """Return the devices, and how many cases each passed."""
    letters = iter(LETTERS)
    lines = []
    for device in devices:
        if "cases" not in device:
            lines.append(("", device["device"], "", "not run", "", ""))
            continue
        counts = Counter(row["verdict"] for row in device["not_passed"])
        fails, others = counts["fail"], counts["not applicable"]
        passed = device["cases"] - fails - others
        cells = (device["device"], device["eds"], str(passed), str(fails), str(others))
        lines.append((next(letters), *cells))
    return table(("", "device", "EDS", "pass", "fail", "not applicable"), *lines)


def refusal_table() -> Iterator[str]:
    """Return the refusals of a device, and their abort codes."""
    head = ("Request", "Cases", "Accepted abort codes", "By")
    lines = [
        (row.what, row.cases, ", ".join(f"{code:08X}h" for code in row.codes), row.source)
        for row in REFUSALS
    ]
    yield from table(head, *lines)


def answer_table(others: list[Verdicts]) -> Iterator[str]:
    """Return the wrong answers of other stacks, each with its request.

    A service that a device lacks is no wrong answer, nor is an abort. The cases of OD ask many
    entries: their last frames need not show the fault.
    """
    lines = []
    for device in others:
        for row in device["not_passed"]:
            asked = [frame for frame in row["frames"] if frame.startswith(">")]
            answer = row["frames"][-1] if row["frames"] else ""
            lacking = row["why"].startswith(("abort", "no ", "0 "))
            if row["verdict"] != "fail" or row["case"].startswith("OD-") or not asked:
                continue
            if row["why"].startswith("no SDO response"):
                answer = "< none"
            elif lacking or answer.startswith(">"):
                continue
            cells = (row["case"], device["device"].split(",")[0], row["rule"], row["why"])
            lines.append((*cells, f"`{asked[-1][2:]}`", f"`{answer[2:]}`"))
    order = {case.number: place for place, case in enumerate(CASES)}
    lines.sort(key=lambda line: order[line[0]])
    return table(("Case", "Stack", "Rule", "Found", "Request", "Answer"), *lines)


def case_tables(run: list[Verdicts], scripted: list[dict[str, Any]]) -> Iterator[str]:
    """Return the cases of each group, the devices that did not pass them, and a deviation."""
    verdicts = [{row["case"]: row["verdict"] for row in device["not_passed"]} for device in run]
    for group, cases in groupby(CASES, key=lambda case: case.group):
        lines = []
        for case in cases:
            marks: dict[str, list[str]] = {}
            for letter, of_device in zip(LETTERS, verdicts, strict=False):
                if case.number in of_device:
                    marks.setdefault(of_device[case.number], []).append(letter)
            lacks = "; ".join(
                ", ".join(letters)
                + MARKS[verdict].replace("fails", "fail" if letters[1:] else "fails")
                for verdict, letters in marks.items()
            )
            least = min(
                (s for s in scripted if case.number in [row["case"] for row in s["fails"]]),
                key=lambda s: len(s["fails"]) + len(s["fails_too"]),
            )
            lines.append(
                (f"{case.number} {case.title}", case.rule, lacks, least["scripted_device"])
            )
        head = ("Case", "Rule", "Not passed", "Fails for")
        yield from (f"## {GROUPS[group]}", "", *table(head, *lines))


def pages(stack: dict[str, Any] | None) -> Pages:
    """Judge all devices of this machine or a stack, and return the page and its data."""
    logging.disable()  # the other devices report each refusal
    old = json.loads(VERDICTS.read_text(encoding="utf-8"))
    devices: list[Verdicts] = old["devices"]
    scripted: list[dict[str, Any]] = old["scripted_devices"]
    if stack is None:
        built = [device for device in devices if device["device"].startswith(BUILT)]
        devices, scripted = all_devices(built), deviations()
    else:
        name = next(name for name in BUILT if stack["stack"].startswith(name))
        place = next(n for n, d in enumerate(devices) if d["device"].startswith(name))
        devices[place] = judged_stack(stack)
    data = json.dumps({"devices": devices, "scripted_devices": scripted}, indent=1) + "\n"
    return {**renewed(PAGE, fields(devices, scripted)), VERDICTS: data}


def main() -> int:
    """Write the page, or compare it."""
    parser = parser_of(__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    of_stack = parser.add_argument_group("a stack that you have built")
    of_stack.add_argument("--stack", metavar="NAME", help=f"begins with {', '.join(BUILT)}")
    of_stack.add_argument("--eds", metavar="FILE")
    of_stack.add_argument("--node-id", type=int)
    of_stack.add_argument("--interface", default="socketcan")
    of_stack.add_argument("--channel", default="vcan0")
    of_stack.add_argument("--command", metavar="LINE")
    options = parser.parse_args()
    if options.stack and not options.stack.startswith(BUILT):
        parser.error(f"--stack {options.stack}: begin with one of {', '.join(BUILT)}")
    if options.stack and not (options.eds and options.node_id and options.command):
        parser.error("--stack needs --eds, --node-id and --command")
    new = pages(vars(options) if options.stack else None)
    if options.check:
        stale = differences(new)
        print("\n".join(stale))
        return 1 if stale else 0
    write(new)
    return 0
