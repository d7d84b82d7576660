import errno
import os
from pathlib import Path

import pytest

from smarttac_can.host.bounded_file import open_regular, read_bounded
from smarttac_can.host.eds_files import MAX_BYTES as EDS_MAX
from smarttac_can.host.eds_files import read_eds_file
from smarttac_can.host.finger_file import read_finger
from smarttac_can.host.storage_file import StorageFile

SPARSE = 8 << 30


def test_a_file_of_the_bound_is_read_and_one_byte_more_is_not(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"1234")
    assert read_bounded(path, 4) == b"1234"
    with pytest.raises(OSError, match="is larger than 3 bytes") as caught:
        read_bounded(path, 3)
    assert (caught.value.errno, caught.value.filename) == (errno.EFBIG, str(path))


def test_a_link_is_followed_and_nothing_is_said_to_be_nothing(tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "file")
    with pytest.raises(FileNotFoundError):
        read_bounded(link, 4)
    (tmp_path / "file").write_bytes(b"1234")
    assert read_bounded(link, 4) == b"1234"


@pytest.mark.parametrize("what", ["pipe", "link to a pipe", "device", "directory"])
def test_what_is_no_file_is_neither_waited_for_nor_read(what: str, tmp_path: Path) -> None:
    path = {"device": Path("/dev/zero"), "directory": tmp_path}.get(what, tmp_path / "it")
    if what.endswith("pipe"):
        os.mkfifo(tmp_path / "pipe")
        path.symlink_to("pipe")
    with pytest.raises(OSError, match="is no regular file"):
        read_bounded(path, 4)
    with pytest.raises(OSError, match="is no regular file"):
        open_regular(path)


def test_what_changes_between_the_look_and_the_opening_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, harmless = tmp_path / "pipe", tmp_path / "file"
    os.mkfifo(path)
    harmless.touch()
    seen = harmless.stat()
    monkeypatch.setattr(Path, "stat", lambda self: seen)
    with pytest.raises(OSError, match="is no regular file"):
        read_bounded(path, 4)


def test_every_reader_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    with path.open("wb") as file:
        file.truncate(SPARSE)
    for read, most in (
        (read_eds_file, 4 << 20),
        (read_finger, 8 << 20),
        (lambda path: StorageFile(path).read(), 4 << 20),
    ):
        with pytest.raises(OSError, match=f"is larger than {most} bytes"):
            read(path)


def test_what_could_not_be_read_again_is_not_stored(tmp_path: Path) -> None:
    storage = StorageFile(tmp_path / "kept")
    storage.write(bytes(4 << 20))
    assert storage.read() == bytes(4 << 20)
    with pytest.raises(OSError, match="is larger than 4194304 bytes"):
        storage.write(bytes(1 + (4 << 20)))
    assert storage.read() == bytes(4 << 20)


def test_an_eds_as_windows_writes_it(tmp_path: Path) -> None:
    path = tmp_path / "some.eds"
    path.write_bytes(b"\x93Temperature [\xb0C]\x94\x81")
    assert read_eds_file(path) == "\u201cTemperature [\u00b0C]\u201d\ufffd"
    path.write_bytes(bytes(EDS_MAX))
    assert len(read_eds_file(path)) == EDS_MAX
