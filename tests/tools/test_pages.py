"""A tool that makes pages says what it makes, and where the pages are."""

import sys
from pathlib import Path

import pytest
from pages import made


def test_tool_names_its_work_and_each_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "new" / "page.md"
    monkeypatch.setattr(sys, "argv", ["make page"])
    assert made("Count to three; minutes.\n\nMore.", lambda _drawn: {page: "three\n"}) == 0
    assert page.read_text() == "three\n"
    assert capsys.readouterr() == ("", f"make page: Count to three; minutes.\nwritten: {page}\n")
