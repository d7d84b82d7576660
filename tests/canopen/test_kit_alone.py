"""The kit ``smarttac_can.canopen`` works without one module of the instrument."""

import subprocess
import sys
from pathlib import Path

import pytest
from rich_eds import RICH_EDS

ROOMS = ("canopen", "_faces")
"""What of ``smarttac_can`` may be imported."""
SCRIPT = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        package, _, room = name.partition(".")
        if package == "smarttac_can" and room and room.split(".")[0] not in ROOMS:
            raise ModuleNotFoundError(f"{name} is no part of the kit")

sys.meta_path.insert(0, Refuse())

import pkgutil
from datetime import datetime
from importlib import import_module
from pathlib import Path

import smarttac_can.canopen

for module in pkgutil.walk_packages(smarttac_can.canopen.__path__, "smarttac_can.canopen."):
    import_module(module.name)

from smarttac_can.canopen.commissioning.dbc import NO_NAMES, make_dbc
from smarttac_can.canopen.commissioning.dcf import make_dcf
from smarttac_can.canopen.conformance.case import DeviceDescription
from smarttac_can.canopen.conformance.examiner import Examiner
from smarttac_can.canopen.conformance.run import CASES, DeviceTimeBus, run_cases
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.canopen.od.eds_check import check_eds

text = Path(sys.argv[1]).read_text()
assert not [finding for finding in check_eds(text, "rich.eds") if finding.error]
made = make_dcf(text, node_id=5, bit_rate=500_000, values={"1017": "200"}, eds_name="rich.eds",
                dcf_name="5.dcf", now=datetime(2026, 1, 1))
od = load_eds(made, 5)
assert od.number(0x1017) == 200
assert "BO_" in make_dbc(od, NO_NAMES)
device = Device(load_eds(text, 5))
device.shutdown = lambda: []
bus = DeviceTimeBus(device)
examiner = Examiner(bus, DeviceDescription(text, 5), clock=bus.time)
wanted = ("SDO-01", "SDO-23", "PDO-02", "EMCY-01", "HB-01", "TRANS-04")
chosen = [case for case in CASES if case.number in wanted]
print([result.verdict for result in run_cases(examiner, chosen)])
print(sorted({name.split(".")[1] for name in sys.modules if name.startswith("smarttac_can.")}))
"""


@pytest.mark.sources
def test_kit_runs_without_the_rooms_of_the_instrument(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f"ROOMS = {ROOMS}\n{SCRIPT}", RICH_EDS],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.stderr == ""
    verdicts, rooms = done.stdout.splitlines()
    assert verdicts == str(["pass"] * 6)
    assert rooms == str(["_faces", "canopen"])
