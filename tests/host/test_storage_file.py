import os
import sys
import threading
from pathlib import Path

import pytest

from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame
from smarttac_can.host.storage_file import StorageFile
from smarttac_can.od.eds import load_eds

EDS = (Path(__file__).parent.parent / "eds" / "rich.eds").read_text()
HEARTBEAT = 0x1017
SAVE = bytes.fromhex("2310100173617665")
EMCY = Frame(0x0A0, bytes.fromhex("3055010000000000"))


def powered(path: Path) -> tuple[Device, list[Frame]]:
    device = Device(load_eds(EDS, 0x20), storage=StorageFile(path))
    return device, device.start()


def heartbeat(device: Device) -> int:
    return device.od.number(HEARTBEAT)


def save(device: Device, period: int) -> bytes:
    device.od.entry(HEARTBEAT).value = period
    (answer,) = device.receive(Frame(0x620, SAVE))
    return answer.data


def test_survives_the_process(tmp_path: Path) -> None:
    path = tmp_path / "node.store"
    device, sent = powered(path)
    assert sent == [Frame(0x720, b"\0")]
    assert save(device, 500)[0] == 0x60
    again, sent = powered(path)
    assert sent == [Frame(0x720, b"\0")]
    assert heartbeat(again) == 500
    assert [p.name for p in tmp_path.iterdir()] == ["node.store"]


def test_a_file_cut_or_garbled_at_any_byte_gives_defaults_and_an_emergency(tmp_path: Path) -> None:
    path = tmp_path / "node.store"
    save(powered(path)[0], 500)
    whole = path.read_bytes()
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


def test_power_cut_while_writing_leaves_the_old_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "node.store"
    device, _ = powered(path)
    save(device, 500)
    old = path.read_bytes()
    save(device, 700)
    new = path.read_bytes()
    for k in range(len(new) + 1):
        path.write_bytes(old)
        path.with_name("node.store.new").write_bytes(new[:k])
        again, sent = powered(path)
        assert heartbeat(again) == 500
        assert sent == [Frame(0x720, b"\0")]
        assert [p.name for p in tmp_path.iterdir()] == ["node.store"]

    def full(_: int) -> None:
        raise OSError("no space left")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        assert save(again, 900) == bytes.fromhex("8010100100000606")
    assert path.read_bytes() == old
    assert save(again, 900)[0] == 0x60
    assert heartbeat(powered(path)[0]) == 900


def test_file_that_cannot_be_read_is_an_error_of_the_device(tmp_path: Path) -> None:
    device, sent = powered(tmp_path)  # a directory
    assert sent == [Frame(0x720, b"\0"), EMCY]
    assert save(device, 500) == bytes.fromhex("8010100100000606")


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    path, kept = tmp_path / "node.store", tmp_path / "disk" / "kept"
    path.symlink_to(kept)
    assert save(powered(path)[0], 500) == bytes.fromhex("8010100100000606"), "no such directory"
    kept.parent.mkdir()
    for period in (500, 700):
        assert save(powered(path)[0], period)[0] == 0x60
        assert path.is_symlink()
        assert heartbeat(powered(kept)[0]) == period
    assert [p.name for p in kept.parent.iterdir()] == ["kept"]


@pytest.mark.skipif(sys.platform == "win32", reason="there are no named pipes in folders")
def test_a_pipe_in_the_place_of_the_new_file_is_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "node.store"
    os.mkfifo(tmp_path / "node.store.new")
    writing = threading.Thread(target=StorageFile(path).write, args=(b"1",), daemon=True)
    writing.start()
    writing.join(5.0)
    assert not writing.is_alive()
    assert path.read_bytes() == b"1"
    assert not (tmp_path / "node.store.new").exists()


@pytest.mark.parametrize("there", [True, False])
def test_a_link_in_the_place_of_the_new_file_is_not_followed(tmp_path: Path, there: bool) -> None:
    path, precious = tmp_path / "node.store", tmp_path / "precious"
    if there:
        precious.write_bytes(b"precious")
    (tmp_path / "node.store.new").symlink_to(precious)
    StorageFile(path).write(b"1")
    assert path.read_bytes() == b"1" and not path.is_symlink()
    assert precious.exists() == there
    assert not there or precious.read_bytes() == b"precious"


def test_a_directory_in_the_place_of_the_new_file_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "node.store"
    path.write_bytes(b"old")
    (tmp_path / "node.store.new").mkdir()
    with pytest.raises(OSError, match=r"node\.store\.new") as refusal:
        StorageFile(path).write(b"1")
    assert len(str(refusal.value).splitlines()) == 1
    assert path.read_bytes() == b"old"
