from collections.abc import Callable
from pathlib import Path

import pytest

from smarttac_can.host.file_errors import in_words, reason, trouble


@pytest.mark.parametrize(
    ("act", "path", "said"),
    [
        (Path.read_bytes, "none", "there is no such file"),
        (Path.read_bytes, "a/b/none", "the folder {}/a does not exist"),
        (lambda path: path.write_text(""), "a/b/none", "the folder {}/a does not exist"),
        (Path.read_bytes, "file/none", "{}/file is a file, not a folder"),
        (lambda path: path.write_text(""), "file/a/none", "{}/file is a file, not a folder"),
        (Path.mkdir, "a/b", "the folder {}/a does not exist"),
        (Path.read_bytes, "", "that is a folder, not a file"),
        (Path.mkdir, "file", "File exists"),
    ],
)
def test_what_hinders_and_what_is_to_be_made(
    act: Callable[[Path], object], path: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    full = tmp_path / path
    with pytest.raises(OSError) as plain:
        act(full)
    assert reason(plain.value) == said.format(tmp_path)
    assert trouble(plain.value) == f"{full}: {said.format(tmp_path)}"
    with pytest.raises(type(plain.value)) as told, in_words():
        act(full)
    assert str(told.value) == trouble(plain.value)
    assert told.value.__suppress_context__


def test_an_error_of_no_file_is_as_it_was() -> None:
    error = OSError(28, "No space left on device")
    assert trouble(error) == "No space left on device"
    with pytest.raises(OSError) as told, in_words():
        raise error
    assert told.value is error


def test_a_relative_name_is_said_as_it_was_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"^a/b: the folder a does not exist$"), in_words():
        Path("a/b").read_bytes()
