import pytest
from one_device import download, play, started

from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame

T2 = 0x1801


def reconfigure(device: Device, n: int, *, transmission: int, inhibit: int = 0, event: int = 0,
                start: int = 0, rtr: bool = False) -> None:  # fmt: skip
    """Change a TPDO by the book."""
    record = 0x1800 + n - 1
    cob_id = device.od.entry(record, 1).value & 0x7FF
    flags = 0 if rtr else 0x40000000
    for subindex, value, size in (
        (1, 0x80000000 | flags | cob_id, 4),
        (2, transmission, 1),
        (3, inhibit, 2),
        (5, event, 2),
        (6, start, 1),
        (1, flags | cob_id, 4),
    ):
        assert download(device, record, subindex, value, size) == 0


def test_type_0_waits_for_the_sync_after_the_event() -> None:
    device = started()
    reconfigure(device, 2, transmission=0)
    play(device, "> 080\n! 2\n+ 1ms\n> 080\n< 2A0 ..\n> 080\n! 2\n! 2\n> 080\n< 2A0 ..\n> 080")


@pytest.mark.parametrize("every", [1, 2, 7, 240])
def test_cyclic_over_three_periods(every: int) -> None:
    device = started()
    reconfigure(device, 2, transmission=every)
    sent = []
    for k in range(1, 3 * every + 1):
        device.od["Counter"].value = k
        sent += play_sync(device)
    assert sent == [every, 2 * every, 3 * every]


def play_sync(device: Device) -> list[int]:
    frames = device.receive(Frame(0x80, b"" if not device.od.entry(0x1019).value else b"\1"))
    return [int.from_bytes(frame.data, "little") for frame in frames]


def test_cyclic_has_no_events() -> None:
    device = started()
    reconfigure(device, 2, transmission=2, event=1)
    play(device, "! 2\n+ 10ms\n> 080\n> 080\n< 2A0 ..")


def test_start_value_makes_that_sync_the_first() -> None:
    device = started()
    assert download(device, 0x1019, 0, 8, 1) == 0
    reconfigure(device, 2, transmission=3, start=4)
    play(
        device,
        """
        > 080 01
        > 080 02
        > 080 03
        > 080 04      # the first
        > 080 05
        > 080 06
        < 2A0 ..
        > 080 07
        > 080 08
        > 080 01
        < 2A0 ..
        > 080 02
        > 080 03
        > 080 04
        < 2A0 ..
        """,
    )


def test_start_value_means_nothing_without_counter() -> None:
    device = started()
    reconfigure(device, 2, transmission=2, start=4)
    play(device, "> 080\n> 080\n< 2A0 ..\n> 080\n> 080\n< 2A0 ..")


def test_type_254_is_sent_at_every_trigger() -> None:
    device = started()
    play(device, "! 3\n< 3A0 00 00 00 00\n! 3\n< 3A0 00 00 00 00\n> 080\n> 080\n+ 1000ms")


def test_type_255_is_sent_at_a_trigger_with_new_data() -> None:
    device = started()
    play(device, "! 1\n< 1A0 00 00 00 00 00 00 00\n! 1\n! 1")
    device.od["Force.S2"].value = -2
    play(device, "! 1\n< 1A0 00 00 FE FF 00 00 00\n! 1\n+ 1000ms")


@pytest.mark.parametrize("transmission", [254, 255])
def test_event_timer(transmission: int) -> None:
    device = started()
    reconfigure(device, 3, transmission=transmission, event=5)
    play(
        device,
        """
        4x + 1ms
        + 1ms
        < 3A0 00 00 00 00
        4x + 1ms
        + 1ms
        < 3A0 00 00 00 00
        + 12ms                 # late: once, the phase is kept
        < 3A0 00 00 00 00
        + 2ms
        + 1ms
        < 3A0 00 00 00 00
        """,
    )
    device.od["Counter"].value = 1
    play(device, "+ 3ms\n! 3\n< 3A0 01 00 00 00\n+ 4ms\n+ 1ms\n< 3A0 01 00 00 00")
    play(device, "> 000 80 20\n+ 100ms\n> 000 01 20\n+ 4ms\n+ 1ms\n< 3A0 ..")


@pytest.mark.parametrize("transmission", [254, 255])
def test_inhibit_time_holds_events_back_and_merges_them(transmission: int) -> None:
    device = started()
    reconfigure(device, 3, transmission=transmission, inhibit=25)
    counter = device.od["Counter"]
    counter.value = 1
    play(device, "! 3\n< 3A0 01 00 00 00\n+ 1ms")
    counter.value = 2
    play(device, "! 3\n+ 1ms")
    counter.value = 3
    play(device, "! 3\n+ 499us\n+ 1us\n< 3A0 03 00 00 00\n+ 10ms")
    counter.value = 4
    play(device, "! 3\n< 3A0 04 00 00 00\n! 3\n> 000 80 20\n> 000 01 20\n+ 10ms")


def test_event_timer_waits_for_the_inhibit_time() -> None:
    device = started()
    reconfigure(device, 3, transmission=254, inhibit=30, event=2)
    play(device, "! 3\n< 3A0 ..\n+ 2ms\n+ 1ms\n< 3A0 ..")


def test_rtr_types() -> None:
    device = started()
    reconfigure(device, 5, transmission=252, rtr=True)
    reconfigure(device, 6, transmission=253, rtr=True)
    counter = device.od["Counter"]
    counter.value = 1
    play(device, "> 1B0 rtr\n< 1B0 01 00 00 00\n> 080")
    counter.value = 2
    play(device, "> 1B0 rtr\n< 1B0 01 00 00 00   # sampled at SYNC\n> 1B0\n! 5\n! 6")
    play(device, "> 2B0 rtr\n< 2B0 FF FF FF D8 FF FF FF FF")
    device.od["INTEGER24"].value = 0x123456
    play(device, "> 2B0 rtr\n< 2B0 56 34 12 D8 FF FF FF FF\n> 000 80 20\n> 2B0 rtr")


def test_rtr_only_where_bit_30_allows() -> None:
    device = started()
    play(device, "> 3A0 rtr")
    reconfigure(device, 3, transmission=254, rtr=True)
    play(device, "> 3A0 rtr\n< 3A0 00 00 00 00")


@pytest.mark.parametrize(
    ("transmission", "code"),
    [(0, 0), (240, 0), (241, 0x06090030), (251, 0x06090030), (252, 0), (253, 0), (254, 0)],
)
def test_transmission_types(transmission: int, code: int) -> None:
    assert download(started(), T2, 2, transmission, 1) == code


@pytest.mark.parametrize(("subindex", "size"), [(3, 2), (6, 1)])
def test_inhibit_and_start_value_are_fixed_while_valid(subindex: int, size: int) -> None:
    device = started()
    assert download(device, T2, subindex, 7, size) == 0x08000022
    assert download(device, T2, subindex, 0, size) == 0, "unchanged"
    assert download(device, T2, 1, 0xC00002A0, 4) == 0
    assert download(device, T2, subindex, 7, size) == 0


@pytest.mark.parametrize(
    ("cob_id", "code"),
    [
        (0x400002A0, 0),
        (0x000002A0, 0),
        (0xC00002A0, 0),
        (0xC0000123, 0),
        (0x400002A1, 0x08000022),
        (0x600002A0, 0x08000022),
    ],
)
def test_can_id_is_fixed_while_valid(cob_id: int, code: int) -> None:
    device = started()
    assert download(device, T2, 1, cob_id, 4) == code
    assert device.od.entry(T2, 1).value == (0x400002A0 if code else cob_id)


@pytest.mark.parametrize(
    "can_id", [0, 0x7F, 0x101, 0x180, 0x581, 0x601, 0x67F, 0x6E0, 0x7FF, 0x800]
)
def test_restricted_can_ids(can_id: int) -> None:
    device = started()
    assert download(device, T2, 1, 0xC0000000 | can_id, 4) == 0
    assert download(device, T2, 1, 0x40000000 | can_id, 4) == 0x06090030
    assert download(device, T2, 1, 0x40000190, 4) == 0
    play(device, "> 080\n> 080\n> 080\n< 190 ..")


def test_29_bit_can_ids_are_refused() -> None:
    device = started()
    assert download(device, T2, 1, 0xC00002A0, 4) == 0
    assert download(device, T2, 1, 0x200002A0, 4) == 0x06090030


def test_disabled_tpdo_is_silent() -> None:
    device = started()
    download(device, 0x1802, 1, 0xC00003A0, 4)
    play(device, "! 3\n! 4\n> 080\n> 080\n> 080\n< 2A0 ..")
