from pathlib import Path

import pytest

from smarttac_can.host import eds_files
from smarttac_can.host.eds_files import read_eds


@pytest.mark.parametrize("name", ["stimulator.eds", "plate.eds"])
def test_both_nodes_have_one(name: str) -> None:
    assert f"FileName={name}" in read_eds(name).replace(" ", "")


def test_packaged_file_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plate.eds").write_text("packaged")
    monkeypatch.setattr(eds_files, "PLACES", (tmp_path, *eds_files.PLACES))
    assert read_eds("plate.eds") == "packaged"
    assert "FileName" in read_eds("stimulator.eds")


def test_missing_file_is_named() -> None:
    with pytest.raises(FileNotFoundError, match=r"no EDS file toaster\.eds"):
        read_eds("toaster.eds")
