"""``tools/lower_bounds`` takes each package that is needed to run; the run itself is a long one."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def tool(load: Callable[[str], ModuleType]) -> ModuleType:
    return load("lower_bounds")


@pytest.fixture
def project() -> dict[str, Any]:
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return project


def test_each_package_is_taken_at_its_lower_bound(tool: ModuleType) -> None:
    project = {
        "name": "own",
        "dependencies": ["first>=1.2,<2"],
        "optional-dependencies": {
            "some": ["own[other]", "second-one>=3"],
            "other": ["third[more]>=4.5.6"],
            "test": ["pytest>=8"],
        },
    }
    with pytest.raises(ValueError, match=r"^third\[more\]>=4\.5\.6 has no lower bound"):
        tool.lower_bounds(project)
    del project["optional-dependencies"]["other"]
    assert tool.lower_bounds(project) == ["first==1.2", "second-one==3"]


def test_each_extra_is_installed_and_has_its_tests(
    tool: ModuleType, project: dict[str, Any]
) -> None:
    assert set(tool.TESTS) == set(project["optional-dependencies"]) - tool.NOT_TO_RUN
    for name in tool.TESTS.values():
        assert (ROOT / "tests" / name).is_file(), name
    assert len(tool.lower_bounds(project)) > len(project["dependencies"])
