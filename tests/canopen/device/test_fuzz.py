from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

import pytest
from rich_eds import RICH

from smarttac_can.canopen.device.sdo import SDOServer
from smarttac_can.canopen.od.entry import Entry

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def fuzz() -> ModuleType:
    loader = SourceFileLoader("fuzz_device", str(ROOT / "tools" / "assurance" / "fuzz_device"))
    spec = spec_from_loader(loader.name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    loader.exec_module(module)
    return module


@pytest.mark.parametrize("eds", ["tests/eds/rich.eds", "eds/stimulator.eds", "eds/plate.eds"])
def test_a_device_keeps_its_promises(fuzz: ModuleType, eds: str) -> None:
    fuzzer = fuzz.run_seed((ROOT / eds).read_text(), 1, 17_000)
    assert fuzzer.answers > 3000
    assert {"OPERATIONAL", "PRE_OPERATIONAL"} <= set(fuzzer.states)


def test_same_seed_gives_the_same_traffic(fuzz: ModuleType) -> None:
    one, two = (fuzz.run_seed(RICH, 3, 2000) for _ in range(2))
    assert (one.answers, one.aborts, one.time_us) == (two.answers, two.aborts, two.time_us)


def test_values_outside_their_limits_are_found(
    fuzz: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Entry, "unpack", lambda entry, data: int.from_bytes(data, "little"))
    with pytest.raises(Exception, match=r".") as caught:
        fuzz.run_seed(RICH, 1, 20_000)
    assert any(note.startswith("seed 1, frame ") for note in caught.value.__notes__)


def test_transfers_without_time_out_are_found(
    fuzz: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(server: SDOServer) -> None:
        server._wait(1)
        server.port.out.append(fuzz.Frame(server._tx & 0x7FF, bytes.fromhex("8000000000000405")))

    monkeypatch.setattr(SDOServer, "_on_time_out", never)
    with pytest.raises(fuzz.BrokenPromiseError, match="still alive"):
        fuzz.run_seed(RICH, 1, 20_000)
