"""A look for what the tests of buses leave behind."""

from collections.abc import Iterator

import psutil
import pytest


@pytest.fixture(autouse=True)
def leaves_no_file(leaves_nothing: None) -> Iterator[None]:
    files = psutil.Process().num_fds()
    yield
    assert psutil.Process().num_fds() == files
