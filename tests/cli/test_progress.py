"""A bar for who looks on, and nothing for a log file."""

import sys
from io import StringIO

import pytest

from smarttac_can.cli.progress import progress_bar


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("stream", "shown"), [(Terminal(), True), (StringIO(), False)])
def test_progress_is_for_a_terminal(
    stream: StringIO, shown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", stream)
    with progress_bar("soaking") as progress:
        progress(0.5)
        progress(1.0)
    said = stream.getvalue()
    assert ("soaking" in said and "100%" in said) if shown else said == ""
