"""The Python of the documentation runs: each page from top to bottom, beside a simulated plate."""

import inspect
import json
import re
import threading
from collections.abc import Iterator
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from shutil import copy
from types import SimpleNamespace
from typing import Any

import canopen
import pytest
from nodes_on_a_bus import GUARD_S, in_threads, stimulator_with_plate, until

from smarttac_can.bench import Stimulator
from smarttac_can.bench.simulation import LocalLink, plate_od, stimulator_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.host.front_ends import TimedFrontEnd
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.science.plant import SUBJECTS
from smarttac_can.science.plant.finger import Trajectory
from smarttac_can.vocabulary.states import State

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
PAGES = sorted(
    page for page in (ROOT / "docs").rglob("*.md") if "```python" in page.read_text("utf-8")
)
MASTER = ROOT / "docs" / "how-to" / "integrate-with-a-master.md"
EDS = ROOT / "eds" / "stimulator.eds"
FRAME = re.compile(r"([0-9A-F]{3})  ((?:[0-9A-F]{2} ?)+)(?:  .*)?")
TO_THE_NODE = (0x000, 0x220, 0x320, 0x620, 0x701)
LONGEST_WAIT = 200
"""Cycles until a frame of the page has to come."""
ALONE = [page for page in PAGES if page != MASTER]
SCRIPT = r"\$ python (?:friction|experiment)\.py"
"""Scripts that need no node, so that their output is the same each time."""
CSV = re.compile(r"^```\n(# format: .*?)```", re.DOTALL | re.MULTILINE)
"""Lines of the file that the last script of a page has written."""
WITHOUT_END = "run_node(node, PythonCanBus("
"""Runs until a signal comes, on a bus that is not there; the runner has tests of its own."""


def simulated() -> Stimulator:
    """Simulate a stimulator without a bus, with a recorded finger to play."""
    recording = Trajectory([(0.0, 0.0, 0.5), (1.0, 0.01, 0.5)])
    block = StimulatorBlock(stimulator_od(), PlateBlock(plate_od(), recording))
    return Stimulator(LocalLink(block), block.od)


def run(page: Path, names: dict[str, Any], request: pytest.FixtureRequest) -> None:
    """Execute the blocks of a page one after the other, and the tests that they define."""
    text = page.read_text(encoding="utf-8")
    for block in BLOCK.finditer(text):
        line = text.count("\n", 0, block.start()) + 1
        source = "\n" * line + block[1].replace('== "..."', '!= "..."')
        code = compile(source, str(page), "exec")
        if WITHOUT_END in source:
            continue
        known = set(names)
        exec(code, names)
        for name in names.keys() - known:
            if name.startswith("test_"):
                test = names[name]
                fixtures = inspect.signature(test).parameters
                test(**{fixture: fresh(fixture, request) for fixture in fixtures})


def fresh(fixture: str, request: pytest.FixtureRequest) -> Any:
    """Return a fixture as pytest gives it to each of several tests."""
    if fixture == "stimulator":
        return request.getfixturevalue("make_stimulator")()
    return request.getfixturevalue(fixture)


@pytest.mark.parametrize("page", ALONE, ids=[page.stem for page in ALONE])
def test_page(
    page: Path,
    request: pytest.FixtureRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    signature = inspect.signature(Stimulator.connect)

    def connect(**options: Any) -> Stimulator:
        signature.bind(**options)
        return Stimulator.simulate("local")

    if "Stimulator.connect(" in "".join(BLOCK.findall(page.read_text(encoding="utf-8"))):
        monkeypatch.setattr(Stimulator, "connect", connect)
    monkeypatch.chdir(tmp_path)
    if page.stem == "lab-data":
        monkeypatch.syspath_prepend(ROOT / "tools" / "pages")
        import_module("lab_data").make_files(tmp_path)
        (tmp_path / "finger.json").write_text(json.dumps({"subject": asdict(SUBJECTS[1])}))
    with simulated() as bench:
        names = {
            "bench": bench,
            "stimulator": bench,
            "trace": bench.run(0.1),
            "node": stimulator_with_plate(),
            "text": stimulator_od().text,
            "path": tmp_path / "trace.csv",
        }
        run(page, names, request)
    printed = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    for shown in re.findall(f"{SCRIPT}\n(.*?)```", page.read_text("utf-8"), re.DOTALL):
        lines = shown.splitlines()
        assert printed[-len(lines) :] == lines
    for shown in CSV.findall(page.read_text("utf-8")):
        assert set(shown.splitlines()) <= set((tmp_path / "run.csv").read_text().splitlines())


def test_bench_guide_shows_model_and_load_of_a_new_simulation(
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = (ROOT / "docs" / "how-to" / "bench-scripts.md").read_text("utf-8")
    shown = re.search(r"^# (\d.*) nm/V, (\d.*) ms, (\d.*) Hz$", page, re.MULTILINE)
    assert shown is not None
    blocks = BLOCK.findall(page)
    (identify,) = (block for block in blocks if "stimulator.identify()" in block)
    (press,) = (block for block in blocks if "load_of_press" in block)
    load = re.search(r'print\(f"{load:.2f}"\)  # (\d.*)$', press, re.MULTILINE)
    assert load is not None
    with Stimulator.simulate() as bench:
        names = {"stimulator": bench}
        exec(identify, names)
        exec(press, names)
    assert capsys.readouterr().out.splitlines() == [
        "{} nm/V, {} ms, {} Hz".format(*shown.groups()),
        load[1],
    ]


def test_the_front_end_of_the_page_lets_a_stimulator_drive(virtual: dict[str, Any]) -> None:
    page = (ROOT / "docs" / "how-to" / "real-hardware.md").read_text("utf-8")
    names: dict[str, Any] = {}
    exec(next(block for block in BLOCK.findall(page) if "class Card" in block), names)
    plate = PlateNode(plate_od(), front_end=TimedFrontEnd(names["Card"]()))
    with (
        in_threads(
            virtual, plate, StimulatorNode(stimulator_od(), plate_node_id=33, lockstep=True)
        ),
        Stimulator.connect(**virtual, plate_node_id=33, lockstep=True) as bench,
    ):
        bench.start_run()
        bench.amplitude = 1.0
        bench.mode = "amplitude_resonance"
        trace = bench.run(0.2)
    assert trace.amplitude_um[-20:].mean() == pytest.approx(1.0, abs=0.02)


@pytest.fixture
def master_page(
    virtual: dict[str, Any],
    request: pytest.FixtureRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],  # before the page prints
) -> Iterator[tuple[StimulatorNode, dict[str, Any]]]:
    """Run the page of a master beside a node; yield the node and the names of the page."""
    connect = canopen.Network.connect
    monkeypatch.setattr(canopen.Network, "connect", lambda self, **_: connect(self, **virtual))
    monkeypatch.setattr(canopen.sdo.SdoClient, "RESPONSE_TIMEOUT", GUARD_S)
    monkeypatch.chdir(tmp_path)
    copy(EDS, tmp_path)
    node = stimulator_with_plate(lockstep=False)
    with in_threads(virtual, node, lockstep=False):
        until(lambda: node.block.supervisor.tared)
        names: dict[str, Any] = {}
        run(MASTER, names, request)
        yield node, names
    # python-can ends the thread of a heartbeat that was stopped with its next period.
    until(
        lambda: not any(thread.name.startswith("Cyclic send") for thread in threading.enumerate())
    )


def near(printed: str) -> str:
    """Take the hundredths of a degree from the output: the plate warms, and has noise."""
    return re.sub(r"(temperature .*) \d{4}\n", r"\1\n", printed)


def test_the_frames_of_the_page_bring_the_first_volt() -> None:
    node = stimulator_with_plate(lockstep=False)
    sent = node.start()
    frames = MASTER.read_text("utf-8").partition("These are the frames")[2].split("```")[1]
    lines = [FRAME.fullmatch(line) for line in frames.strip().splitlines()]
    assert len(lines) == 14
    voltages = []
    for line in lines:
        assert line is not None
        frame = Frame(int(line[1], 16), bytes.fromhex(line[2]))
        if frame.can_id in TO_THE_NODE:
            sent = node.receive(frame)
        else:
            for _ in range(LONGEST_WAIT):
                if frame in sent:
                    break
                sent = node.advance(1000)
            assert frame in sent, line[0]
        voltages.append(node.od["Vibration.Voltage"].read())
    assert voltages[-3:] == [1000, 0, 0]


def test_a_master_of_python_canopen_leaves_the_plate_at_0_V(
    master_page: tuple[StimulatorNode, dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    node, _ = master_page
    (shown,) = re.findall(r"It prints:\n\n```\n(.*?)```", MASTER.read_text("utf-8"), re.DOTALL)
    *printed, remapped = capsys.readouterr().out.splitlines()
    assert near("\n".join(map(str.rstrip, printed)) + "\n") == near(shown)
    assert remapped == "['Contact.COF uncertainty [0.0001]', 'Contact.Force x [mN]']"
    assert node.block.supervisor.state is State.READY
    assert node.od["Consumer heartbeat time.Consumer heartbeat time 1"].value == 0


def test_the_page_of_the_mapping_has_the_answer_to_each_wrong_step() -> None:
    page = (ROOT / "docs" / "reference" / "pdos-and-states.md").read_text("utf-8")
    table = page.partition("The answer to a wrong step is")[2].partition("After a refusal")[0]
    shown = re.findall(r"^\| .* \| ([0-9A-F]{8})h \|$", table, re.MULTILINE)
    node = stimulator_with_plate(lockstep=False)
    node.start()

    def write(index: int, subindex: int, value: int, size: int) -> str | None:
        head = bytes((0x23 | 4 - size << 2, index & 0xFF, index >> 8, subindex))
        data = head + value.to_bytes(4, "little")
        (answer,) = (f for f in node.receive(Frame(0x620, data)) if f.can_id == 0x5A0)
        code = int.from_bytes(answer.data[4:], "little")
        return f"{code:08X}" if answer.data[0] == 0x80 else None

    answers = [write(0x1A03, 0, 0, 1), write(0x1A03, 1, 0x20300410, 4)]
    assert write(0x1803, 1, 0x8000_04A0, 4) is None
    assert write(0x1A03, 0, 0, 1) is None
    answers += [write(0x1A03, 1, 0x77770010, 4), write(0x1A03, 1, 0x10000020, 4)]
    assert write(0x1A03, 1, 0x20300408, 4) == answers[-1]
    for place in range(1, 6):
        assert write(0x1A03, place, 0x20300410, 4) is None
    answers += [write(0x1A03, 0, 5, 1), write(0x1A03, 0, 9, 1)]
    assert answers == shown


def test_a_refusal_is_told_in_words_by_the_master_of_the_page(
    master_page: tuple[StimulatorNode, dict[str, Any]],
    request: pytest.FixtureRequest,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(canopen.Network, "send_periodic", lambda *_: SimpleNamespace(stop=print))
    capsys.readouterr()
    run(MASTER, {}, request)
    said = capsys.readouterr().out
    assert said.startswith("Code 0x08000022, ")
    assert "\nready: " in said
    assert master_page[0].block.supervisor.state is State.READY


def test_a_master_of_python_canopen_resets_a_fault(
    master_page: tuple[StimulatorNode, dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    node, names = master_page
    assert node.block.supervisor.state is State.READY, node.od["Message"].value
    network = canopen.Network()
    network.connect()
    try:
        master = network.add_node(32, str(EDS))
        master.sdo["Consumer heartbeat time"][1].raw = names["MASTER"] << 16 | 60_000
        network.send_message(0x700 + names["MASTER"], [5])
        for controlword in (0, 1, 3):
            master.sdo["Controlword"].raw = controlword
        master.sdo["Consumer heartbeat time"][1].raw = names["MASTER"] << 16 | 50
        until(lambda: node.block.supervisor.state is State.FAULT)
        master.sdo["Consumer heartbeat time"][1].raw = 0
        capsys.readouterr()
        names["reset_fault"](master)
        until(lambda: node.block.supervisor.state is State.READY)
    finally:
        network.disconnect()
    assert capsys.readouterr().out == (
        "8131h: the heartbeat of a supervised node is lost\npresent 0h, latched 2h\n"
    )


def test_the_master_of_the_page_goes_on_where_it_was_killed(
    master_page: tuple[StimulatorNode, dict[str, Any]],
    request: pytest.FixtureRequest,
    capsys: pytest.CaptureFixture[str],
) -> None:
    node, names = master_page
    network = canopen.Network()
    network.connect()
    try:
        master = network.add_node(32, str(EDS))
        master.sdo["Consumer heartbeat time"][1].raw = names["MASTER"] << 16 | 500
        network.send_message(0x700 + names["MASTER"], [5])
        for controlword in (0, 1, 3):
            master.sdo["Controlword"].raw = controlword
        until(lambda: node.block.supervisor.state is State.FAULT)
        until(lambda: node.device.nmt_state is NMTState.PRE_OPERATIONAL)
    finally:
        network.disconnect()
    capsys.readouterr()
    run(MASTER, {}, request)
    (first,) = re.findall(
        r"heartbeat that is back:\n\n```\n(.*?)```", MASTER.read_text("utf-8"), re.DOTALL
    )
    assert capsys.readouterr().out.startswith(first)
    assert node.block.supervisor.state is State.READY
