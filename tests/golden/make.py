"""Write the files of one version of this package, to be read by all later ones.

``python tests/golden/make.py FOLDER`` makes them with the version that is installed. What is there
is never made again: a new version gets a folder of its own.
"""

import lzma
import sys
import tempfile
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from time import sleep

import can

from smarttac_can.bench import BenchError, Stimulator, Texture, write_csv
from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.canopen.commissioning.dcf import make_dcf
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.storage import Memory
from smarttac_can.canopen.master import requests
from smarttac_can.host.files import read_eds
from smarttac_can.host.log_file import CandumpWriter
from smarttac_can.host.python_can import to_message
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.faults import FaultKind

SAVE = int.from_bytes(b"save", "little")
NODE_ID = 32


def recordings(folder: Path) -> None:
    """Write a recording with its log, the raw log, traces, and a texture."""
    log: list[tuple[int, Frame]] = []
    with Stimulator.simulate(log=lambda *frame: log.append(frame)) as bench:
        bench.finger.stroke(2, force=0.5, speed=200.0)
        bench.start_run()
        bench.tare()
        bench.amplitude = 1.0
        bench.voltage = 20
        bench.run(0.1)
        with bench.record(folder / "recording.h5") as recording:
            bench.mode = "friction"
            bench.cof = 0.3, 0.4
            trace = bench.run(0.08, "golden.friction", 2)
            bench.mark("trial 1: Fläche")
            bench.texture = Texture.grating(2.0, 0.25, 0.45)
            bench.texture_slot = 2
            bench.texture = Texture.profile("ramp", 0.2, 0.4, 0.05)
            bench.mode = "texture"
            played = bench.run(0.08, "golden.texture", 2)
            bench.disarm()
            bench.run(0.01)
            wait_for_the_log(recording.log_path)
            (folder / "killed.h5.log").write_bytes(recording.log_path.read_bytes())
    write_csv(folder / "traces.csv", [trace, played])
    trace.to_csv(folder / "trace.csv")
    with (folder / "raw.log").open("w") as file:
        for time, frame in log:
            CandumpWriter(file).write(time, frame)
    with can.Logger(folder / "raw.blf") as logger:
        for time, frame in log[:500]:
            message = to_message(frame)
            message.timestamp = 1e9 + time * 1e-6
            logger(message)
    (folder / "texture.stx").write_bytes(Texture.grating(2.0, 0.25, 0.45).table.pack())


def wait_for_the_log(path: Path) -> None:
    """Wait until the thread that writes it every quarter of a second has written all."""
    size = -1
    while path.stat().st_size != size:
        size = path.stat().st_size
        sleep(1.0)


def stored(folder: Path) -> None:
    """Write the parameters that a stimulator stores by 1010h, and its faults."""
    memory = Memory()
    node = StimulatorNode(stimulator_od(), plate_node_id=33, lockstep=True, storage=memory)
    node.start()
    node.od["Limit.Voltage"].value = 6_000
    node.od["Texture table.Table 3"].value = Texture.grating(2.0, 0.25, 0.45).table.pack()
    node.receive(requests.download(NODE_ID, node.od.entry(0x1010, 1), SAVE))
    data = memory.read()
    assert data is not None
    (folder / "node.bin").write_bytes(data)
    (folder / "node.bin.faults").write_text("".join(f"{line}\n" for line in faults()), "ascii")


def faults() -> tuple[str, ...]:
    """Return the lines of two faults."""
    with Stimulator.simulate("local") as bench:
        link = bench._link
        for kind in (FaultKind.STUCK, FaultKind.STUCK):
            bench.start_run()
            bench.voltage = 10
            bench.mode = "open_loop"
            bench.run(0.2)
            bench.set("Fault.Sensor", 1)
            bench.set("Fault.Kind", kind)
            with suppress(BenchError):
                bench.run(0.3)
            bench.set("Fault.Kind", 0)
            bench.run(0.2)
            bench.reset_fault()
        return link._block.supervisor.memory.lines  # type: ignore[attr-defined]


def configured(folder: Path) -> None:
    """Write a DCF, and the EDS of which it was made."""
    eds = read_eds("stimulator.eds")
    text = make_dcf(
        eds,
        node_id=40,
        bit_rate=1_000_000,
        values={"Limit.Voltage": "60 V"},
        eds_name="stimulator.eds",
        dcf_name="stimulator.dcf",
        now=datetime(2026, 1, 1, tzinfo=UTC),
    )
    (folder / "stimulator.dcf").write_text(text)
    (folder / "stimulator.eds").write_text(eds)


def main() -> None:
    """Make them all, compressed."""
    target = Path(sys.argv[1])
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        recordings(folder)
        stored(folder)
        configured(folder)
        for path in folder.iterdir():
            (target / f"{path.name}.xz").write_bytes(lzma.compress(path.read_bytes(), preset=9))


if __name__ == "__main__":
    main()
