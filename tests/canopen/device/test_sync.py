import pytest
from one_device import download, play, reconfigure, started

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.service import Application


class Order(Application):
    def __init__(self) -> None:
        self.calls: list[str] = []

    def on_sync(self) -> bool:
        self.calls.append("sync")
        return True

    def on_rpdo(self, number: int) -> None:
        self.calls.append(f"rpdo {number}")


def test_counting_starts_anew_in_operational() -> None:
    device = started()
    play(device, "> 080\n> 080\n> 000 80 20\n> 080\n> 000 01 20\n> 080\n> 080\n> 080\n< 2A0 ..")


def test_sync_latches_rpdos_then_calls_application_then_samples() -> None:
    application = Order()
    device = started(application)
    reconfigure(device, 2, transmission=1)

    def count() -> bool:
        application.calls.append("sync")
        device.od["Counter"].value = 100 + device.od["Mode"].value
        return True

    application.on_sync = count  # type: ignore[method-assign]
    play(
        device,
        """
        > 320 04
        > 320 05          # the last one before SYNC counts
        > 080
        < 2A0 69 00 00 00
        > 080             # not delivered twice
        < 2A0 69 00 00 00
        """,
    )
    assert application.calls == ["rpdo 2", "sync", "sync"]


def test_producer() -> None:
    application = Order()
    device = started(application)
    assert download(device, 0x1006, 0, 2000, 4) == 0
    play(device, "+ 10ms")
    assert download(device, 0x1005, 0, 0x40000080, 4) == 0
    play(device, "+ 1999us\n+ 1us\n< 080\n+ 2ms\n< 080\n+ 2ms\n< 080\n< 2A0 ..")
    assert application.calls == ["sync"] * 3, "it acts on its own SYNC"
    assert download(device, 0x1006, 0, 5000, 4) == 0
    play(device, "+ 4ms\n+ 1ms\n< 080\n> 000 02 20\n+ 20ms")


def test_sync_counter_restarts_at_1_after_overflow_and_stopped() -> None:
    device = started(operational=False)
    assert download(device, 0x1019, 0, 3, 1) == 0
    assert download(device, 0x1006, 0, 1000, 4) == 0
    assert download(device, 0x1005, 0, 0x40000080, 4) == 0
    play(device, "4x + 1ms\n< 080 01\n< 080 02\n< 080 03\n< 080 01")
    play(device, "> 000 02 20\n> 000 80 20\n+ 1ms\n< 080 01")


@pytest.mark.parametrize(
    ("value", "code"),
    [
        (0x800000A5, 0),  # bit 31 means nothing
        (0x20000080, 0x06090030),
        (0x00000880, 0x06090030),
    ],
)
def test_sync_cob_id(value: int, code: int) -> None:
    device = started()
    assert download(device, 0x1005, 0, value, 4) == code
    if not code:
        play(device, "> 080\n> 080\n> 080\n> 0A5\n> 0A5\n> 0A5\n< 2A0 ..")


def test_wrong_length_is_reported_once_and_ignored() -> None:
    application = Order()
    device = started(application)
    play(
        device,
        """
        > 080 01
        < 0A0 40 82 11 01 00 00 00 00
        > 080 02
        > 080
        < 0A0 00 00 00 00 00 00 00 00
        > 080 rtr
        """,
    )
    assert application.calls == ["sync"]
    device = started()
    download(device, 0x1019, 0, 10, 1)
    play(device, "> 080\n< 0A0 40 82 11 00 00 00 00 00")


def test_window_drops_synchronous_rpdos_that_come_late() -> None:
    device = started()
    rpdo = next(n for n in range(4) if device.od.entry(0x1400 + n, 2).value <= 240)
    cob_id = device.od.entry(0x1400 + rpdo, 1).value & 0x7FF
    mapped = device.od.entry(0x1600 + rpdo, 1).value
    target = device.od.entry(mapped >> 16, mapped >> 8 & 0xFF)
    size = sum(device.od.entry(0x1600 + rpdo, k + 1).value & 0xFF
               for k in range(device.od.entry(0x1600 + rpdo, 0).value)) // 8  # fmt: skip
    assert download(device, 0x1007, 0, 2000, 4) == 0

    def receive(value: int) -> None:
        device.receive(Frame(cob_id, bytes((value,)) + bytes(size - 1)))

    device.receive(Frame(0x080))
    device.advance(2000)
    receive(1)
    device.receive(Frame(0x080))
    assert target.value == 1
    device.advance(2001)
    receive(2)
    device.receive(Frame(0x080))
    assert target.value == 1
    receive(3)
    device.receive(Frame(0x080))
    assert target.value == 3


def produced(device: Device, step: int) -> bool:
    return any(frame.can_id == 0x080 for frame in device.advance(step))


def test_after_a_late_sync_the_next_comes_a_whole_period_later() -> None:
    device = started()
    download(device, 0x1006, 0, 1000, 4)
    download(device, 0x1005, 0, 0x40000080, 4)
    assert produced(device, 1000)
    assert produced(device, 1250), "a quarter of the period late"
    assert produced(device, 750), "the phase is kept"
    assert produced(device, 1251)
    assert not produced(device, 999)
    assert produced(device, 1)
    assert device.sync.missed == 0
    assert produced(device, 4750)
    assert device.sync.missed == 4, "0.251 and 3.75 ms"
    assert not produced(device, 999)
    assert produced(device, 1)


def test_synchronous_tpdos_wait_for_an_application_with_a_sample() -> None:
    class Silent(Application):
        measures = False

        def on_sync(self) -> bool:
            return self.measures

    application = Silent()
    device = started(application)
    reconfigure(device, 2, transmission=1)
    sync = Frame(0x80)
    assert device.receive(sync) == []
    application.measures = True
    assert device.receive(sync) != []


DAY_US = 86_400_000_000
NOON_OF_DAY_3 = "> 100 00 2E 93 02 03 00\n"


def test_time_goes_on_by_device_time() -> None:
    device = started()
    assert device.time is None
    play(device, NOON_OF_DAY_3)
    assert device.time == 3 * DAY_US + DAY_US // 2
    device.advance(1234)
    assert device.time == 3 * DAY_US + DAY_US // 2 + 1234


def test_reserved_bits_are_ignored() -> None:
    device = started()
    play(device, "> 100 00 2E 93 F2 03 00")
    assert device.time == 3 * DAY_US + DAY_US // 2


def test_time_stamp_ignores_short_remote_and_foreign_frames() -> None:
    device = started()
    play(device, "> 100 00 2E 93 02 03\n> 100 rtr\n> 101 00 2E 93 02 03 00")
    assert device.time is None


def test_cob_id() -> None:
    device = started()
    assert download(device, 0x1012, 0, 0x80000101, 4) == 0x08000022, "in use"
    assert download(device, 0x1012, 0, 0x00000100, 4) == 0
    play(device, NOON_OF_DAY_3)
    assert device.time is None
    assert download(device, 0x1012, 0, 0x80000101, 4) == 0x06090030, "restricted"
    assert download(device, 0x1012, 0, 0xC0000100, 4) == 0x06090030, "producer"
    assert download(device, 0x1012, 0, 0xA0000100, 4) == 0x06090030, "29 bits"
    assert download(device, 0x1012, 0, 0x80000200, 4) == 0
    device.receive(Frame(0x200, bytes(6)))
    assert device.time == 0


def test_time_outlives_a_reset_and_is_not_heard_while_stopped() -> None:
    device = started()
    play(device, NOON_OF_DAY_3 + "> 000 82 20\n< 720 00\n+ 1ms\n> 000 02 20\n> 100" + " 00" * 6)
    assert device.time == 3 * DAY_US + DAY_US // 2 + 1000
