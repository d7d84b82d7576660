"""``smarttac panel`` as a process: without a bus, on a bus, and its refusals."""

import asyncio
import re
import signal
import socket
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from time import monotonic, process_time
from typing import Any

import can
import psutil
import pytest
from aiohttp import ClientSession
from commands import refusal
from nodes_on_a_bus import (
    GUARD_S,
    NodeProcess,
    in_threads,
    multicast_options,
    stimulator_with_plate,
)
from open_pages import Browser, Page

from smarttac_can.bench import BenchError, Stimulator
from smarttac_can.bench.panel.instrument import BusInstrument
from smarttac_can.bench.watch.commands import in_words
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import Law, Mode


@pytest.fixture
def node(multicast: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> Iterator[StimulatorNode]:
    """Run a node in a thread, which ends no run because the machine is busy.

    It waits longer than usual for the heartbeat of a bench of this process, which starts others.
    """
    monkeypatch.setattr("smarttac_can.bench.remote_device._LOST_MS", 20_000)
    made = stimulator_with_plate(lockstep=False)
    with in_threads(multicast, made, lockstep=False):
        yield made


async def shows(node: StimulatorNode, mode: Mode) -> None:
    """Return once the node itself shows a mode; the bound is a guard."""
    guard = monotonic() + GUARD_S
    while node.od["Mode display"].value != mode:
        assert monotonic() < guard, node.od["Message"].value
        await asyncio.sleep(0.01)


@contextmanager
def panel(*options: str) -> Iterator[tuple[NodeProcess, str, int]]:
    """Run the command; yields it with its token and port."""
    process = NodeProcess("panel", "--port", "0", *options)
    try:
        said = process.lines.get(timeout=GUARD_S)
        found = re.fullmatch(r"panel of .*: http://127\.0\.0\.1:(\d+)/#(\S{22})", said)
        assert found, said
        yield process, found[2], int(found[1])
    finally:
        process.end(signal.SIGKILL)


def on_a_page(port: int, token: str, script: Callable[[Page], Awaitable[None]]) -> None:
    async def run() -> None:
        async with ClientSession() as session, Browser(session, port, token).page() as page:
            await script(page)

    asyncio.run(run())


async def drive(page: Page) -> None:
    """Have a page drive, again where a busy machine has missed it or has tripped the node."""
    guard = monotonic() + GUARD_S
    while page.now.get("state") != "running":
        assert monotonic() < guard, page.now
        if not page.now["drives"]:
            await page.send(do="drive")
        elif page.now.get("state") == "fault":
            await page.send(do="line", text="reset")
        elif page.now.get("state") == "ready":
            await page.line("voltage 20")
            await page.send(do="line", text="mode open_loop")
        await asyncio.sleep(0.3)


refused = partial(refusal, "panel", code=None)


def test_a_simulated_bench_reaches_no_bus(
    monkeypatch: pytest.MonkeyPatch, multicast: dict[str, Any]
) -> None:
    """Nor does one that finds a bus in python-can's configuration."""
    for name in ("interface", "channel"):
        monkeypatch.setenv(f"CAN_{name.upper()}", multicast[name])
    monkeypatch.setenv("CAN_CONFIG", f'{{"port": {multicast["port"]}}}')
    with can.Bus(**multicast) as bus, panel() as (process, token, port):

        async def script(page: Page) -> None:
            assert page.introduction["simulated"]
            await drive(page)
            sockets = psutil.Process(process.process.pid).net_connections("all")
            tcp = {(each.laddr.ip, each.laddr.port) for each in sockets if each.laddr}
            assert tcp == {("127.0.0.1", port)}

        on_a_page(port, token, script)
        assert bus.recv(0.2) is None
        status, _, complaint = process.end(signal.SIGTERM)
    assert (status, complaint) == (0, "")


@pytest.mark.sources
def test_panel_takes_at_most_twice_the_time_of_its_cycles() -> None:
    """The simulated bench with a page that drives, against the same cycles without a page."""
    with Stimulator.simulate("local") as bench:
        bench.finger.stroke(2)
        bench.start_run()
        bench.tare()
        bench.mode = "friction"
        shares = []
        for _ in range(3):
            begun = process_time()
            bench.run(1.0)
            shares.append(process_time() - begun)
    with panel() as (process, token, port):

        async def script(page: Page) -> None:
            await drive(page)
            of_panel = psutil.Process(process.process.pid)
            for _ in range(3):  # of which a busy machine leaves one alone
                begun, before = monotonic(), sum(of_panel.cpu_times()[:2])
                await asyncio.sleep(1.0)
                share = (sum(of_panel.cpu_times()[:2]) - before) / (monotonic() - begun)
                if share <= 2.0 * min(shares):
                    return
            pytest.fail(f"{share} of a core, and {min(shares)} for its cycles")

        on_a_page(port, token, script)


def test_without_drive_a_page_looks_on(node: StimulatorNode, multicast: dict[str, Any]) -> None:
    with Stimulator.connect(**multicast) as bench:
        bench.voltage = 20.0
        bench.law, bench.texture_slot = "predictive", 3
        bench.mode = "open_loop"
        with panel(*multicast_options(multicast)) as (_, token, port):

            async def script(page: Page) -> None:
                assert not page.introduction["simulated"]
                assert not page.introduction["drives"]
                await page.until(lambda: page.now.get("state") == "running")
                await page.until(lambda: page.now["values"].get("Setpoint.Voltage") == 20.0)
                await page.until(lambda: page.now["values"].get("Texture.Slot") == 3)
                await page.until(lambda: page.now["values"].get("Friction law") == Law.PREDICTIVE)
                await page.until(lambda: "Vibration.W_d" in page.now["values"])
                await page.send(do="drive")
                await page.send(do="stop")
                await page.send(do="line", text="mode off")
                await page.until(lambda: "does not drive" in page.now["answer"])
                assert page.now["bus_load"] > 0.0
                assert not page.now["drives"]

            on_a_page(port, token, script)
            assert node.od["Mode display"].value == Mode.OPEN_LOOP


def test_it_drives_a_bus_and_stops(node: StimulatorNode, multicast: dict[str, Any]) -> None:
    options = (*multicast_options(multicast), "--drive")
    with Stimulator.connect(**multicast) as other, panel(*options) as (process, token, port):

        async def script(page: Page) -> None:
            await drive(page)
            await shows(node, Mode.OPEN_LOOP)
            with pytest.raises(BenchError, match=r"^another bench script drives node 32"):
                await asyncio.to_thread(setattr, other, "mode", "amplitude")
            await page.line("amplitude 1.5")
            await page.send(do="line", text="amplitude 99")
            await page.until(lambda: "amplitude 99 um is above 3 um" in page.now["answer"])
            await page.send(do="stop")
            await page.until(lambda: page.now["state"] == "ready")
            await shows(node, Mode.OFF)
            await page.line("mode open_loop")
            await shows(node, Mode.OPEN_LOOP)
            page.silent = True
            await shows(node, Mode.OFF)
            page.silent = False
            await page.answer()
            await page.until(lambda: "was not heard for 0.8 s" in page.now["answer"])
            await drive(page)

        on_a_page(port, token, script)
        asyncio.run(shows(node, Mode.OFF))
        assert process.end(signal.SIGTERM)[0] == 0


def test_panel_refuses_to_drive_while_another_bench_drives(
    node: StimulatorNode, multicast: dict[str, Any]
) -> None:
    """Other benches take a panel for one of them: see the test before."""
    with Stimulator.connect(**multicast) as bench:
        bench.voltage = 20.0
        bench.mode = "open_loop"
        with panel(*multicast_options(multicast), "--drive") as (_, token, port):

            async def script(page: Page) -> None:
                await page.send(do="drive")
                await page.until(lambda: page.now["drives"])
                await page.send(do="line", text="mode amplitude")
                await page.until(lambda: "another bench script drives" in page.now["answer"])
                assert node.od["Mode display"].value == Mode.OPEN_LOOP

            on_a_page(port, token, script)


def test_a_panel_that_is_killed_leaves_0_v(node: StimulatorNode, multicast: dict[str, Any]) -> None:
    options = (*multicast_options(multicast), "--drive")
    with panel(*options) as (process, token, port):

        async def script(page: Page) -> None:
            await drive(page)
            await shows(node, Mode.OPEN_LOOP)
            process.process.send_signal(signal.SIGKILL)
            await shows(node, Mode.OFF)
            assert node.od["Message"].value == "the heartbeat of a supervised node is lost"

        on_a_page(port, token, script)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_panel_command_ends_at_0_v_when_its_instrument_fails(
    node: StimulatorNode, multicast: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its thread ends, while the heartbeat of the bench would go on."""
    step = BusInstrument.step

    def fails_while_driving(instrument: BusInstrument, now: float) -> None:
        step(instrument, now)
        if node.od["Mode display"].value == Mode.OPEN_LOOP:
            raise RuntimeError("a defect")

    async def drives(instrument: BusInstrument, *_: object) -> None:
        """Stand for the server: drive, and return as it does when the instrument has failed."""
        instrument.lease.take(self := object(), monotonic() + GUARD_S)
        for text in ("voltage 20", "mode open_loop"):
            instrument.command(self, text)
            while instrument.alive and instrument.answer != f"done: {in_words(text)}":
                await asyncio.sleep(0.01)

    monkeypatch.setattr(BusInstrument, "step", fails_while_driving)
    monkeypatch.setattr("smarttac_can.bench.panel.server.serve", drives)
    monkeypatch.setattr("smarttac_can.bench.panel.server.Panel", lambda instrument, *_: instrument)
    assert refused(*multicast_options(multicast), "--drive") == (
        "the panel has failed; the plate is at 0 V"
    )
    asyncio.run(shows(node, Mode.OFF))


def test_a_port_that_is_taken_is_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert "address already in use" in refused("--port", str(taken.getsockname()[1]))


@pytest.mark.parametrize("options", [("--drive",), ("--channel", "x"), ("--plate-node", "33")])
def test_panel_command_names_missing_bus_options(options: tuple[str, ...]) -> None:
    assert refused(*options) == "a bus needs --interface; without one a bench is simulated"


def test_a_panel_that_looks_on_records_nothing(tmp_path: Path) -> None:
    said = refused("--interface", "virtual", "--record", str(tmp_path / "folder"))
    assert said == "--record needs --drive: without it no page may record"


@pytest.mark.parametrize(
    "host", ["0.0.0.0", "::", "0", "00", "0x0", "0.0", "000.0.0.0", "0:0::0", "::ffff:0.0.0.0", ""]
)
def test_every_address_is_none(host: str) -> None:
    said = host or "''"
    assert refused("--host", host) == f"Invalid value: --host {said} is every address: name one"


def test_panel_command_without_aiohttp_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smarttac_can.cli.bench.find_spec", lambda _: None)
    assert refused() == "panel needs aiohttp: pip install 'smarttac-can[panel]'"
