"""Packages have faces: what they name can be had, costs nothing before, and guides use them."""

import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import smarttac_can

ROOT = Path(__file__).parents[1]
PACKAGES = [
    f"smarttac_can.{m.name}" for m in pkgutil.iter_modules(smarttac_can.__path__) if m.ispkg
]
GUIDES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("package", [name for name in PACKAGES if name != "smarttac_can.cli"])
def test_what_a_face_names_can_be_had(package: str) -> None:
    face = importlib.import_module(package)
    assert face.__doc__
    assert face.__all__
    for name in face.__all__:
        assert getattr(face, name) is not None
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        face.nothing  # noqa: B018


@pytest.mark.parametrize("guide", GUIDES, ids=lambda path: path.stem)
def test_guides_import_from_faces_only(guide: Path) -> None:
    found = re.findall(r"(?:from|import) (smarttac_can[\w.]*)", guide.read_text(encoding="utf-8"))
    assert set(found) <= {"smarttac_can", *PACKAGES}


def loaded_by(statement: str) -> set[str]:
    code = f"import sys; {statement}; print('\\n'.join(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(run.stdout.split())


def test_a_face_loads_nothing_of_its_package() -> None:
    faces = ", ".join(name for name in PACKAGES if name.rpartition(".")[2] not in ("bench", "cli"))
    loaded = loaded_by(f"import {faces}")
    assert {name for name in loaded if name.count(".") > 1 and name.startswith("smarttac")} == set()


def test_the_bench_and_its_fixtures_load_neither_canopen_nor_matplotlib() -> None:
    assert not loaded_by("import smarttac_can.bench") & {"can", "canopen", "matplotlib"}
