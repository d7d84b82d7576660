import pytest
from one_device import download, play, reconfigure, started

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.service import Application


class Log(Application):
    def __init__(self) -> None:
        self.calls: list[str] = []

    def on_rpdo(self, number: int) -> None:
        self.calls.append(f"rpdo {number}")

    def on_rpdo_timeout(self, number: int, late: bool) -> None:
        self.calls.append(f"{'late' if late else 'in time'} {number}")


def test_values_are_in_before_the_application_hears_of_it() -> None:
    seen = []

    class Reader(Application):
        def on_rpdo(self, number: int) -> None:
            seen.append((number, od["Setpoint.Voltage"].value, od["Setpoint.Offset"].value))

    device = started(Reader())
    od = device.od
    play(device, "> 220 E8 03 A0 35 42 00 FE FF")
    assert seen == [(1, 1000, -2)]
    assert od["Setpoint.Frequency"].value == 0x4235A0


def test_tpdo_triggered_by_the_application_follows_the_rpdo() -> None:
    class Loop(Application):
        def on_rpdo(self, number: int) -> None:
            device.od["Counter"].value += number
            device.trigger(3)

    device = started(Loop())
    for k in range(1, 4):
        play(device, f"> 220 E8 03 A0 35 42 00 FE FF\n< 3A0 {k:02X} 00 00 00")


@pytest.mark.parametrize(
    ("data", "where"),
    [
        ("21 4E A0 35 42 00 00 00", "00 21 01"),
        ("00 00 00 00 00 00 00 00", "00 21 02"),
        ("00 00 A0 35 42 00 E9 03", "00 21 03"),
    ],
)
def test_one_value_out_of_limits_and_nothing_changes(data: str, where: str) -> None:
    application = Log()
    device = started(application)
    play(
        device,
        f"""
        > 220 01 00 A0 35 42 00 07 00
        > 220 {data}
        < 0A0 00 82 11 01 00 {where}
        > 220 {data}                    # still the same error
        """,
    )
    od = device.od
    assert (od["Setpoint.Voltage"].value, od["Setpoint.Offset"].value) == (1, 7)
    assert application.calls == ["rpdo 1"]
    play(device, "> 220 01 00 A0 35 42 00 07 00\n< 0A0 00 00 00 00 00 00 00 00")


def test_too_short_is_ignored_too_long_is_cut() -> None:
    application = Log()
    device = started(application)
    play(
        device,
        """
        > 320                            # RPDO 2 carries one byte
        < 0A0 10 82 11 02 00 00 01 00
        > 320
        > 320 05 06
        < 0A0 00 00 00 00 00 00 00 00
        < 0A0 20 82 11 02 00 02 01 00
        > 080
        > 320 04
        < 0A0 00 00 00 00 00 00 00 00
        > 080
        > 080
        < 2A0 ..
        """,
    )
    assert device.od["Mode"].value == 4
    assert application.calls == ["rpdo 2", "rpdo 2"]


def test_remote_frame_is_no_rpdo() -> None:
    application = Log()
    play(started(application), "> 220 rtr")
    assert application.calls == []


def test_latched_data_is_dropped_on_leaving_operational() -> None:
    application = Log()
    device = started(application)
    play(device, "> 320 05\n> 000 80 20\n> 000 01 20\n> 080")
    assert application.calls == []


def test_deadline() -> None:
    application = Log()
    device = started(application)
    assert download(device, 0x1400, 5, 10, 2) == 0
    play(
        device,
        """
        + 100ms                                 # monitoring starts with the first RPDO
        > 220 01 00 A0 35 42 00 07 00
        + 9ms
        > 220 01 00 A0 35 42 00 07 00
        + 9ms
        + 1ms
        < 0A0 50 82 11 01 00 00 00 00
        + 100ms                                 # once
        > 220 01 00 A0 35 42 00 07 00
        < 0A0 00 00 00 00 00 00 00 00
        + 10ms
        < 0A0 50 82 11 01 00 00 00 00
        """,
    )
    assert application.calls == [
        *("rpdo 1", "rpdo 1", "late 1"),
        *("in time 1", "rpdo 1", "late 1"),
    ]
    play(device, "> 000 80 20\n< 0A0 00 00 00 00 00 00 00 00\n+ 100ms")


def test_rpdo_deadlines_latch_each_and_reset_when_all_are_clear() -> None:
    device = started()
    for record in (0x1400, 0x1401):
        assert download(device, record, 5, 10, 2) == 0
    play(
        device,
        """
        > 220 01 00 A0 35 42 00 07 00
        > 320 01                                # synchronous: in force at SYNC
        > 080
        + 5ms
        > 320 01
        + 5ms
        < 0A0 50 82 11 01 00 00 00 00
        < 0A0 50 82 11 02 00 00 00 00
        > 320 01
        > 320 01
        > 080
        > 220 01 00 A0 35 42 00 07 00
        < 0A0 00 00 00 00 00 00 00 00
        """,
    )


def test_dummies_are_skipped() -> None:
    device = started()
    assert download(device, 0x1402, 1, 0x420, 4) == 0
    play(device, "> 420 FF 39 05 EE EE EE EE")
    assert device.od["Setpoint.Voltage"].value == 1337


def test_odd_sizes() -> None:
    device = started()
    play(device, "> 520 FE FF FF 01 00 00 00 80")
    assert device.od["INTEGER24"].value == -2
    assert device.od["INTEGER40"].value == -0x7FFFFFFFFF


def test_two_rpdos_on_one_can_id_both_hear_it() -> None:
    application = Log()
    device = started(application)
    assert download(device, 0x1402, 1, 0x220, 4) == 0
    play(device, "> 220 01 00 00 35 42 00 07 00\n< 0A0 20 82 11 03 00 08 07 00")
    assert application.calls == ["rpdo 1", "rpdo 3"]
    play(device, "> 220 01 00 A0 35 42 00 07 00\n< 0A0 00 82 11 03 00 00 21 01")
    play(device, "> 220 01 00 A0 35 42 00 07 00  # two errors at once do not displace each other")
    assert application.calls == ["rpdo 1", "rpdo 3", "rpdo 1", "rpdo 1"]


DRIVE = "220 01 00 A0 35 42 00 07 00"
LATE = "0A0 50 82 11 01 00 00 00 00"


@pytest.mark.parametrize("broken", ["220 01 00", "220 21 4E A0 35 42 00 00 00"])
def test_a_pdo_that_is_not_taken_does_not_keep_the_deadline(broken: str) -> None:
    device = started()
    assert download(device, 0x1400, 5, 10, 2) == 0
    play(device, f"> {DRIVE}\n+ 9ms\n> {broken}\n< 0A0 ..\n+ 1ms\n< {LATE}")


def test_a_broken_pdo_leaves_the_one_that_waits_for_sync() -> None:
    application = Log()
    device = started(application)
    assert download(device, 0x1400, 2, 1, 1) == 0
    play(device, f"> {DRIVE}\n> 220 21 4E A0 35 42 00 00 00\n< 0A0 00 82 11 01 00 00 21 01\n> 080")
    assert application.calls == ["rpdo 1"]
    assert device.od["Setpoint.Voltage"].value == 1


@pytest.mark.parametrize(
    ("subindex", "value", "size", "left"), [(5, 30, 2, 11), (5, 20, 2, 1), (2, 254, 1, 1)]
)
def test_rpdo_deadline_counts_from_the_last_pdo_despite_writes(
    subindex: int, value: int, size: int, left: int
) -> None:
    application = Log()
    device = started(application)
    assert download(device, 0x1400, 5, 20, 2) == 0
    play(device, f"> {DRIVE}\n+ 19ms")
    assert download(device, 0x1400, subindex, value, size) == 0
    play(device, f"+ {1000 * left - 1}us\n+ 1us\n< {LATE}")
    assert application.calls == ["rpdo 1", "late 1"]


def test_new_parameters_do_not_make_a_late_pdo_come() -> None:
    application = Log()
    device = started(application)
    assert download(device, 0x1400, 5, 10, 2) == 0
    play(device, f"> {DRIVE}\n+ 10ms\n< {LATE}")
    assert download(device, 0x1400, 2, 254, 1) == 0
    assert download(device, 0x1400, 5, 500, 2) == 0
    assert application.calls == ["rpdo 1", "late 1"]


def test_a_synchronous_pdo_is_late_without_sync() -> None:
    application = Log()
    device = started(application)
    assert download(device, 0x1400, 2, 1, 1) == 0
    assert download(device, 0x1400, 5, 10, 2) == 0
    play(device, f"> {DRIVE}\n> 080\n+ 9ms\n> {DRIVE}\n+ 1ms\n< {LATE}")
    assert application.calls == ["rpdo 1", "late 1"]


def test_rpdo_is_not_late_after_its_event_timer_is_cleared() -> None:
    application = Log()
    device = started(application)
    assert download(device, 0x1400, 5, 10, 2) == 0
    play(device, f"> {DRIVE}\n+ 10ms\n< {LATE}")
    play(device, "> 620 2B 00 14 05 00 00 00 00\n< 0A0 ..\n< 5A0 60 00 14 05 00 00 00 00")
    assert application.calls == ["rpdo 1", "late 1", "in time 1"]


T2 = 0x1801


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


@pytest.mark.parametrize(
    ("transmission", "tpdo", "rpdo"),
    [
        (0, 0, 0),
        (240, 0, 0),
        (241, 0x06090030, 0x06090030),
        (251, 0x06090030, 0x06090030),
        (252, 0, 0x06090030),
        (253, 0, 0x06090030),
        (254, 0, 0),
    ],
)
def test_transmission_types(transmission: int, tpdo: int, rpdo: int) -> None:
    device = started()
    assert download(device, T2, 2, transmission, 1) == tpdo
    assert download(device, 0x1400, 2, transmission, 1) == rpdo


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


@pytest.mark.parametrize("cob_id", [0x200002A0, 0x40000800])
def test_can_ids_of_more_than_11_bits_are_refused(cob_id: int) -> None:
    device = started()
    assert download(device, T2, 1, 0xC00002A0, 4) == 0
    assert download(device, T2, 1, cob_id, 4) == 0x06090030
