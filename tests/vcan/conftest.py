"""Real processes on real SocketCAN; collected only where this folder is asked for by its path.

A machine without the buses is a failure, not a skip: run it as ``tools/with-vcan -- tools/test
tests/vcan``.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from processes import is_up

HERE = Path(__file__).parent


def pytest_ignore_collect(config: pytest.Config) -> bool | None:
    asked = [(config.invocation_params.dir / arg.split("::")[0]).resolve() for arg in config.args]
    return None if any(path.is_relative_to(HERE) for path in asked) else True


@pytest.fixture(scope="session", autouse=True)
def buses() -> None:
    for bus in ("vcan0", "vcan1"):
        if not is_up(bus):
            pytest.fail(f"{bus} does not exist or is down: run this below tools/with-vcan")
