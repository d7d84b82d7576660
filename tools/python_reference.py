"""The Python reference: what the faces of the packages name, as Markdown pages."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

from smarttac_can.od.object_reference import table

PACKAGE: Final = Path(__file__).resolve().parent.parent / "smarttac_can"
FACES: Final = (
    "bench", "vocabulary", "nodes", "host", "device", "od", "master", "plant", "control",
    "commissioning", "conformance", "paper", "trials", "timing", "audit", "replay",
)  # fmt: skip
"""From what most people import to what fewest do; a name that several have is of the first."""


class Name(NamedTuple):
    """What a face names."""

    face: str
    name: str
    value: Any

    @property
    def summary(self) -> str:
        """First line of its docstring; of a constant, that below its assignment."""
        text = _constants(self.face)[self.name] if self.is_constant else inspect.getdoc(self.value)
        lines = (text or "").splitlines() or [""]
        return lines[0].replace("``", "`").replace("|", "\\|")

    @property
    def is_constant(self) -> bool:
        """Whether it is neither class nor function."""
        return not (inspect.isclass(self.value) or inspect.isroutine(self.value))

    @property
    def directive(self) -> str:
        """Name of the directive of autodoc that shows it."""
        if self.is_constant:
            return "py:data"
        return "autoclass" if inspect.isclass(self.value) else "autofunction"


@cache
def _constants(face: str) -> dict[str, str]:
    """Return the text below each assignment in the modules of a package, by name."""
    found = {}
    for path in sorted((PACKAGE / face).glob("*.py")):
        for before, after in pairwise(ast.parse(path.read_text(encoding="utf-8")).body):
            match before, after:
                case (
                    ast.AnnAssign(target=ast.Name(id=name))
                    | ast.Assign(targets=[ast.Name(id=name)]),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ):
                    found[name] = inspect.cleandoc(text)
    return found


def _names(face: str) -> list[Name]:
    module = import_module(f"smarttac_can.{face}")
    return [Name(face, name, getattr(module, name)) for name in module.__all__]


def python_pages() -> Iterator[tuple[str, str]]:
    """Give the path of each page, from docs/reference, and its text."""
    made = "Made by `tools/reference.py` from the docstrings: change those."
    seen: dict[int, Name] = {}
    rows = []
    for face in FACES:
        names = _names(face)
        own = [name for name in names if seen.setdefault(id(name.value), name) is name]
        doc = (import_module(f"smarttac_can.{face}").__doc__ or "").strip()
        rows.append((f"[`smarttac_can.{face}`](python/{face}.md)", doc))
        yield f"python/{face}.md", _page(face, f"{doc}\n\n{made}", names, own, seen)
    lines = [
        "# Python",
        "",
        "What packages name in their faces, and nothing else, is there for others to import.",
        "",
    ]
    yield "python.md", "\n".join([*lines, *table(("Package", "What it is"), *rows)])


def _page(face: str, head: str, names: list[Name], own: list[Name], seen: dict[int, Name]) -> str:
    rows = []
    for name in names:
        home = seen[id(name.value)].face
        where = "" if home == face else f" ([{home}]({home}.md))"
        rows.append((f"`{name.name}`{where}", name.summary))
    lines = [f"# `smarttac_can.{face}`", "", head, "", *table(("Name", "What it is"), *rows)]
    if own:
        lines += ["```{eval-rst}"]
        for name in own:
            lines += [f".. {name.directive}:: smarttac_can.{face}.{name.name}"]
            if name.is_constant:
                lines += ["", f"   {name.summary}", ""]
            if name.directive == "autoclass":
                lines += ["   :inherited-members: object, int, tuple, Exception, Enum"]
        lines += ["```", ""]
    return "\n".join(lines)
