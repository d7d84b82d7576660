"""``smarttac plate --front-end``: hardware in Python as a node on a bus."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest
from commands import refusal
from nodes_on_a_bus import processes
from test_node_commands import VIRTUAL

from smarttac_can.bench import BenchError, FaultError, Stimulator

MODULE = '''
from mmap import mmap
from pathlib import Path
from struct import pack
from smarttac_can.science.plant import SUBJECTS, Lifted, Plate, PlateParameters
from smarttac_can.vocabulary import Drive

class Lab:
    """The simulated plate as if it were hardware; fails while there is a file that says so."""
    def __init__(self):
        self.plate = Plate(PlateParameters(), SUBJECTS[0], Lifted())
        self.drive = Drive(0.0, 0.0)
        # In memory: a disk that is slow beside another job looks like a call that hangs.
        with open("told", "w+b") as file:
            file.truncate(8)
            self.told = mmap(file.fileno(), 8)
    def put_out(self, drive):
        self.drive = drive
        self.told[:] = pack("<d", drive.voltage)
        return drive.voltage
    def sample(self):
        if Path("broken").exists():
            raise OSError("cable out")
        self.plate.step(self.drive, self.drive)
        return self.plate.sample()
    def close(self):
        Path("closed").touch()
'''


def told() -> float:
    """Return the voltage that the front end was told last."""
    return float(struct.unpack("<d", Path("told").read_bytes())[0])


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "lab.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_front_end_in_the_loop_that_fails_and_comes_back(
    multicast: dict[str, Any], lab: Path
) -> None:
    nodes = ("plate --lockstep --front-end lab:Lab", "node --plate-node 33 --lockstep")
    with processes(multicast, *nodes) as (plate, _):
        with Stimulator.connect(**multicast, plate_node_id=33, lockstep=True) as bench:
            bench.run(0.2)
            bench.amplitude = 1.0
            bench.mode = "amplitude"
            trace = bench.run(0.1)
            assert abs(trace.amplitude_um[-20:].mean() - 1.0) < 0.02
            assert told() > 10
            (lab / "broken").touch()
            with pytest.raises(BenchError, match="3 cycles in a row were lost"):
                bench.run(0.1)
            assert told() == 0.0
            assert bench.get("Diagnosis.Code") == 0x9010
            plate.wait_for("plate 33 front end: sample() failed: OSError('cable out')")
            (lab / "broken").unlink()
            with pytest.raises(FaultError):
                bench.run(0.1)  # the cycles pass all the same
            bench.reset_fault()
            bench.mode = "amplitude"
            bench.run(0.1)
            assert told() > 10
        status, lines, complaints = plate.end()
        assert (status, complaints) == (0, "")
        assert lines[-1] == "plate 33 stopped at 0 V"
        assert told() == 0.0
        assert (lab / "closed").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--front-end", "nothing"), "no front end 'nothing' (none is installed)"),
        (("--front-end", "lab:Nope"), "cannot import front end lab:Nope"),
        (("--front-end", "lab:Lab", "--finger", "none"), "--finger is for the simulated plate"),
        (("--front-end", "lab:Lab", "--subject", "2"), "--subject is for the simulated plate"),
        (("--front-end", "lab:Lab", "--seed", "2"), "--seed is for the simulated plate"),
    ],
)
def test_refusals(arguments: tuple[str, ...], message: str, lab: Path) -> None:
    assert message in refusal("plate", *VIRTUAL, *arguments, code=None)
    assert not (lab / "told").exists()
