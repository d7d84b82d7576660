"""Options and checks that hold for all tests."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--write-golden",
        action="store_true",
        help="write what the nodes do now over the transcripts under tests/nodes/golden",
    )
