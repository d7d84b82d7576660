"""A look for leaks of the tests of buses."""

from collections.abc import Iterator

import psutil
import pytest


@pytest.fixture(autouse=True)
def leaves_no_file(leaves_nothing: None) -> Iterator[None]:
    files = psutil.Process().num_fds()
    yield
    assert psutil.Process().num_fds() == files
