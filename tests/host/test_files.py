"""Files that a person names: opened with care, replaced as a whole, complained of in words."""

import contextlib
import errno
import gc
import os
import resource
import signal
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from interrupts import interrupted
from nodes_on_a_bus import GUARD_S, until
from read_once import read_once
from rich_eds import RICH

from smarttac_can.bench import Stimulator
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.cli.nodes import read_finger
from smarttac_can.host import files
from smarttac_can.host.files import (
    MAX_EDS_BYTES,
    FaultFile,
    StorageFile,
    in_words,
    open_regular,
    part_of,
    read_bounded,
    read_eds,
    read_eds_file,
    read_lines,
    reason,
    result_file,
    trouble,
)

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
def test_open_regular_refuses_pipes_and_devices_at_once(what: str, tmp_path: Path) -> None:
    path = {"device": Path("/dev/zero"), "directory": tmp_path}.get(what, tmp_path / "it")
    if what.endswith("pipe"):
        os.mkfifo(tmp_path / "pipe")
        path.symlink_to("pipe")
    with pytest.raises(OSError, match="is no regular file"):
        read_bounded(path, 4)
    with pytest.raises(OSError, match="is no regular file"):
        open_regular(path)


def test_open_regular_refuses_a_file_changed_before_opening(
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


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("1, 2 ,3\r\n", ["1", "2", "3"]),
        ('"a, ""b""", 5" tube,"c"d,\n', ['a, "b"', '5" tube', "cd", ""]),
        ('1,"2\n3",4', ["1", "2\n3", "4"]),
        ('1,"2""\n', None),
        ('"1""2', None),
        (" \n", []),
    ],
)
def test_cells_of_a_row_may_be_in_quotes(text: str, found: list[str] | None) -> None:
    assert files.cells(text) == found


def test_storage_refuses_parameters_it_could_not_read_again(tmp_path: Path) -> None:
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
    path.write_bytes(bytes(MAX_EDS_BYTES))
    assert len(read_eds_file(path)) == MAX_EDS_BYTES


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
def test_file_error_names_its_path_and_reason(
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


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), OSError("of another")])
def test_an_error_of_no_file_is_as_it_was(error: OSError) -> None:
    with pytest.raises(OSError) as told, in_words():
        raise error
    assert told.value is error


def test_a_relative_name_is_said_as_it_was_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"^a/b: the folder a does not exist$"), in_words():
        Path("a/b").read_bytes()


# Files for results that cannot be written to the end: a full disk, or an interrupt.


@contextmanager
def nearly_full() -> Iterator[None]:
    """Let a file have 4 kB: its errors come where those of a full disk do."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


def test_a_file_that_fails_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("old")
    with pytest.raises(OSError) as told, result_file(path) as file, nearly_full():
        file.write("x" * 100_000)
    assert (told.value.errno, told.value.filename) == (errno.EFBIG, str(path))
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_full_disk_at_close_leaves_no_result_file(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    with pytest.raises(OSError) as told, nearly_full(), result_file(path) as file:
        file.write("x" * 5000)
    assert told.value.filename == str(path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
def test_interrupt_at_any_instruction_leaves_no_partial_file(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"

    def ended(instruction: int) -> bool:
        try:
            with interrupted(instruction, files, contextlib), ExitStack() as stack:
                stack.enter_context(result_file(path)).write("new")
        except KeyboardInterrupt:
            return False
        return True

    instruction = 0
    while not ended(instruction):
        gc.collect(1)  # as a process does that ends: objects kept alive by the traceback are closed
        left = {file.name: file.read_text() for file in tmp_path.iterdir()}
        assert left in ({}, {"t.csv": "new"}), instruction
        path.unlink(missing_ok=True)
        instruction += 1
    assert instruction > 100
    assert path.read_text() == "new"


def test_a_device_is_written_itself() -> None:
    with pytest.raises(OSError) as told, result_file(Path("/dev/full")) as file:
        file.write("x")
    assert (told.value.errno, told.value.filename) == (errno.ENOSPC, "/dev/full")


def test_a_link_stays_one(tmp_path: Path) -> None:
    (tmp_path / "link.csv").symlink_to(tmp_path / "t.csv")
    with result_file(tmp_path / "link.csv") as file:
        file.write("new")
    assert (tmp_path / "link.csv").is_symlink()
    assert (tmp_path / "t.csv").read_text() == "new"


HEARTBEAT = 0x1017
SAVE = bytes.fromhex("2310100173617665")
EMCY = Frame(0x0A0, bytes.fromhex("3055010000000000"))


def powered(path: Path) -> tuple[Device, list[Frame]]:
    device = Device(read_once(RICH, 0x20), storage=StorageFile(path))
    return device, device.start()


def heartbeat(device: Device) -> int:
    return device.od.number(HEARTBEAT)


def save(device: Device, period: int) -> bytes:
    device.od.entry(HEARTBEAT).value = period
    (answer,) = device.receive(Frame(0x620, SAVE))
    return answer.data


def test_cut_or_garbled_storage_file_gives_defaults_and_emcy(tmp_path: Path) -> None:
    path = tmp_path / "node.store"
    assert save(powered(path)[0], 500)[0] == 0x60
    whole = path.read_bytes()
    again, sent = powered(path)
    assert (heartbeat(again), sent) == (500, [Frame(0x720, b"\0")])
    broken = [whole[:k] for k in range(len(whole))]
    broken += [whole[:k] + bytes((whole[k] ^ 0xFF,)) + whole[k + 1 :] for k in range(len(whole))]
    broken += [whole + b"\0", whole * 2]
    for data in broken:
        path.write_bytes(data)
        device, sent = powered(path)
        assert sent == [Frame(0x720, b"\0"), EMCY], data
        assert heartbeat(device) == 0
        assert all(entry.value == entry.default for entry in device.od if entry.index > 0x1003)
    sent = device.receive(Frame(0x620, SAVE))
    assert [f.data[0] for f in sent] == [0x00, 0x60], "a good store takes the error back"


def test_power_cut_or_full_disk_while_writing_keeps_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "node.store"
    file = StorageFile(path)
    file.write(b"old")
    for k in range(4):
        part_of(path).write_bytes(b"new"[:k])
        assert StorageFile(path).read() == b"old"
        assert list(tmp_path.iterdir()) == [path]

    def full(_: int) -> None:
        raise OSError("no space left")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="no space left"):
            file.write(b"new")
    assert list(tmp_path.iterdir()) == [path]
    assert file.read() == b"old"
    file.write(b"new")
    assert file.read() == b"new"


@pytest.mark.skipif(sys.platform == "win32", reason="it cannot open directories")
def test_storage_file_is_synced_before_its_rename_and_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, done = tmp_path / "node.store", []
    fsync, replace = os.fsync, Path.replace

    def sync(descriptor: int) -> None:
        done.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")
        assert os.path.samestat(os.fstat(descriptor), tmp_path.stat()) == (done[-1] == "folder")
        fsync(descriptor)

    def rename(part: Path, target: Path) -> Path:
        assert part.read_bytes() == b"new"
        done.append("name")
        return replace(part, target)

    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(Path, "replace", rename)
    StorageFile(path).write(b"new")
    assert done == ["file", "name", "folder"]
    assert path.read_bytes() == b"new"


def test_file_that_cannot_be_read_is_an_error_of_the_device(tmp_path: Path) -> None:
    device, sent = powered(tmp_path)  # a directory
    assert sent == [Frame(0x720, b"\0"), EMCY]
    assert save(device, 500) == bytes.fromhex("8010100100000606")


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    path, kept = tmp_path / "node.store", tmp_path / "disk" / "kept"
    path.symlink_to(kept)
    with pytest.raises(FileNotFoundError):
        StorageFile(path).write(b"1")
    kept.parent.mkdir()
    for data in (b"1", b"2"):
        StorageFile(path).write(data)
        assert path.is_symlink()
        assert kept.read_bytes() == data
    assert list(kept.parent.iterdir()) == [kept]


def stored(path: Path) -> None:
    StorageFile(path).require_writable()
    StorageFile(path).read()
    StorageFile(path).write(b"new")


def reported(path: Path) -> None:
    with result_file(path) as file:
        file.write("new")


def recorded(path: Path) -> None:
    with Stimulator.simulate() as bench, bench.record(path):
        bench.run(0.01)


OTHERS = ("new", "part", "1.part", "0123456789abcde.part", "0123456789ABCDEF.part")
"""Names that a user may have given a file beside ours, which he names NAME."""


@pytest.mark.parametrize("make", [stored, reported, recorded])
@pytest.mark.parametrize("kind", ["file", "link", "dangling link", "pipe", "folder"])
def test_a_new_file_leaves_all_that_is_beside_it(
    kind: str, make: Callable[[Path], None], tmp_path: Path
) -> None:
    path, precious = tmp_path / "run.h5", tmp_path / "precious"
    precious.write_text("precious")
    beside = [path.with_name(f"{path.name}.{other}") for other in OTHERS]
    for other in beside:
        match kind:
            case "file":
                other.write_text("precious")
            case "link":
                other.symlink_to(precious)
            case "dangling link":
                other.symlink_to(tmp_path / "nothing")
            case "pipe":
                os.mkfifo(other)
            case "folder":
                other.mkdir()
    before = {other: (other.lstat().st_ino, other.lstat().st_mtime_ns) for other in beside}
    making = threading.Thread(target=make, args=(path,), daemon=True)
    making.start()
    making.join(GUARD_S)
    assert not making.is_alive(), "it waits for a pipe"
    assert {o: (o.lstat().st_ino, o.lstat().st_mtime_ns) for o in beside} == before
    assert precious.read_text() == "precious"
    assert set(tmp_path.iterdir()) == {path, precious, *beside}
    assert path.stat().st_size


@pytest.mark.parametrize("kind", ["file", "link", "pipe"])
def test_a_name_that_is_taken_meanwhile_is_not_written(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An attacker knows the name first: it is refused, at once."""
    path, taken, precious = (tmp_path / name for name in ("t.csv", "t.csv.0.part", "precious"))
    precious.write_text("precious")
    monkeypatch.setattr(files, "part_of", lambda _path: taken)
    for make in (reported, stored):
        match kind:
            case "file":
                taken.write_text("precious")
            case "link":
                taken.symlink_to(precious)
            case "pipe":
                os.mkfifo(taken)
        with pytest.raises(FileExistsError) as refused:
            make(path)
        assert refused.value.filename == str(path)
        assert not path.exists()
        taken.unlink(missing_ok=True)
    assert precious.read_text() == "precious"


def test_a_part_left_by_a_power_failure_is_removed_alone(tmp_path: Path) -> None:
    path, precious = tmp_path / "node[1].store", tmp_path / "precious"
    precious.write_bytes(b"precious")
    part_of(path).write_bytes(b"half")
    part_of(path).write_bytes(b"")
    link, folder, neighbour = part_of(path), part_of(path), part_of(tmp_path / "node1.store")
    link.symlink_to(precious)
    folder.mkdir()
    neighbour.write_bytes(b"half")
    assert StorageFile(path).read() is None
    assert set(tmp_path.iterdir()) == {precious, link, folder, neighbour}


def test_a_file_that_cannot_take_its_place_is_named(tmp_path: Path) -> None:
    path = tmp_path / "node.store"
    path.mkdir()
    with pytest.raises(OSError) as refused:
        StorageFile(path).write(b"1")
    assert refused.value.filename == str(path)
    assert refused.value.filename2 is None
    assert list(tmp_path.iterdir()) == [path]


# Lines that are kept in a file, by a thread, at most so often.


def never(error: OSError) -> None:
    raise AssertionError(error)


class CountingFile(StorageFile):
    writes = 0

    def write(self, data: bytes) -> None:
        self.writes += 1
        super().write(data)


def test_lines_come_back(tmp_path: Path) -> None:
    file = StorageFile(tmp_path / "kept")
    assert read_lines(file) == ()
    lines: tuple[str, ...] = ()
    with FaultFile(file, lambda: lines, never):
        lines = ("new", "old \xb5")
    assert read_lines(file) == ("new", "old ?")


def test_stored_file_of_binary_bytes_is_read_as_short_lines(tmp_path: Path) -> None:
    path = tmp_path / "kept"
    path.write_bytes(b"\xff\x1b[2J\n" + b"x" * 10_000)
    assert read_lines(StorageFile(path)) == ("??[2J", "x" * 500)


def test_they_are_written_while_it_lasts_and_not_more_often(tmp_path: Path) -> None:
    file = CountingFile(tmp_path / "kept")
    number = 0
    with FaultFile(file, lambda: (str(number),), never, 0.05):
        start = time.monotonic()
        while file.writes < 3:
            number += 1
            assert time.monotonic() < start + GUARD_S
        assert time.monotonic() >= start + 0.1
    assert read_lines(file) == (str(number),)


def test_unchanged_parameters_are_not_written_again(tmp_path: Path) -> None:
    file = CountingFile(tmp_path / "kept")
    with FaultFile(file, lambda: ("same",), never, 0.01):
        time.sleep(0.05)
    assert file.writes == 0


def test_a_file_that_fails_is_said_once_and_tried_again(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    file = StorageFile(folder / "kept")
    said: list[OSError] = []
    lines: tuple[str, ...] = ()
    with FaultFile(file, lambda: lines, said.append, 0.01):
        lines = ("fault",)
        until(lambda: said)
        time.sleep(0.05)
        folder.mkdir()
    assert len(said) == 1
    assert read_lines(file) == ("fault",)


def test_packaged_file_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plate.eds").write_text("packaged")
    monkeypatch.setattr(files, "PLACES", (tmp_path, *files.PLACES))
    assert read_eds("plate.eds") == "packaged"
    assert "FileName" in read_eds("stimulator.eds")


def test_missing_file_is_named() -> None:
    with pytest.raises(FileNotFoundError, match=r"no EDS file toaster\.eds"):
        read_eds("toaster.eds")
