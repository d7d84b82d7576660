"""Packages have faces: their names can be imported, cost nothing before, and guides use them."""

import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import smarttac_can

ROOT = Path(__file__).parents[1]
FOUND = [*pkgutil.walk_packages(smarttac_can.__path__, "smarttac_can.")]
PACKAGES = {module.name for module in FOUND if module.ispkg}
# A room that holds packages alone has no face, and the command has none.
MODULES = {m.name for m in FOUND if not (m.ispkg or m.name.endswith("__main__"))}
FACES = sorted({name.rpartition(".")[0] for name in MODULES} - {"smarttac_can", "smarttac_can.cli"})
PYTHON = ROOT / "docs" / "reference" / "python.md"
GUIDES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FOR_USERS = [guide for guide in GUIDES if guide.parent.name not in ("history", "dev")]


@pytest.mark.parametrize("package", FACES)
def test_face_names_can_be_imported(package: str) -> None:
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
    assert set(found) <= {"smarttac_can", *FACES}


@pytest.mark.parametrize("guide", FOR_USERS, ids=lambda path: path.stem)
def test_names_in_guides_are_in_a_face(guide: Path) -> None:
    named = set(re.findall(r"`(smarttac_can\.[\w.]*\w)", guide.read_text(encoding="utf-8")))
    for package, _, name in (each.rpartition(".") for each in named - PACKAGES):
        assert name in importlib.import_module(package).__all__


def test_the_reference_lists_every_face() -> None:
    listed = re.findall(r"^\| \[`([\w.]+)`\]", PYTHON.read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(listed) == FACES


def loaded_by(statements: str) -> set[str]:
    code = f"import sys\n{statements}\nprint(*sys.modules, file=sys.stderr)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(run.stderr.split())


def imports(*packages: str) -> str:
    return f"import {', '.join(f'smarttac_can.{package}' for package in packages)}"


HEAVY = {"aiohttp", "cantools", "h5py", "matplotlib", "numba", "textual"}
HELP = """
sys.argv[1:] = ["--help"]
from smarttac_can.__main__ import run
try:
    run()
except SystemExit:
    pass
"""
PURE = (
    "canopen.od",
    "vocabulary",
    "canopen.device",
    "science.plant",
    "science.control",
    "instrument.nodes",
    "science.population",
)


@pytest.mark.parametrize("face", ["canopen.commissioning", "host", "canopen.master"])
def test_face_with_bus_modules_loads_nothing_of_its_package(face: str) -> None:
    loaded = loaded_by(imports(face))
    assert not {name for name in loaded if name.startswith(f"smarttac_can.{face}.")}
    assert not loaded & {"can", "canopen"}


@pytest.mark.parametrize(
    ("statements", "unwanted"),
    [
        (f"import {', '.join(FACES)}", HEAVY),
        # Pure modules and readers of logs have no bus.
        (
            imports(*PURE, "instrument.replay", "canopen.conformance"),
            {"can", "canopen", *HEAVY},
        ),
        # A node needs nothing that reports alone do.
        (imports("cli.nodes"), {"matplotlib", "scipy", "pytest", "hypothesis"}),
        # A report needs matplotlib only to draw, and figures need no window.
        (imports("studies.paper.report"), {"matplotlib"}),
        (imports("studies.paper.figures"), {"matplotlib.pyplot"}),
        # The modules of a command are loaded when it is called.
        (HELP, {"can", "canopen", "numpy", "matplotlib"}),
    ],
    ids=["faces", "pure", "node", "report", "figures", "help"],
)
def test_import_loads_no_heavy_library_it_does_not_need(
    statements: str, unwanted: set[str]
) -> None:
    loaded = loaded_by(statements)
    assert any(name.startswith("smarttac_can.") for name in loaded)
    assert not loaded & unwanted
