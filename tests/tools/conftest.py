"""Tools as modules, whose names a test may change."""

import sys
from collections.abc import Callable
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

import pytest

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Return a function that imports a file of ``tools/`` afresh."""

    def loaded(name: str) -> ModuleType:
        file = TOOLS / name
        monkeypatch.syspath_prepend(file.parent)
        loader = SourceFileLoader(file.stem, str(file))
        spec = spec_from_loader(loader.name, loader)
        assert spec is not None
        module = module_from_spec(spec)
        monkeypatch.setitem(sys.modules, loader.name, module)
        loader.exec_module(module)
        return module

    return loaded


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Return a function that calls a loaded tool with arguments, and returns its exit code."""

    def called(tool: ModuleType, *arguments: str) -> int:
        monkeypatch.setattr(sys, "argv", [tool.__name__, *arguments])
        code: int = tool.main()
        return code

    return called
