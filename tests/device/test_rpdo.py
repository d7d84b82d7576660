import pytest
from one_device import download, play, started

from smarttac_can.device.application import Application


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


def test_what_the_application_triggers_goes_out_with_the_rpdo() -> None:
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


def test_deadlines_are_latched_per_rpdo_and_reset_when_all_are_clear() -> None:
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


@pytest.mark.parametrize("transmission", [241, 251, 252, 253])
def test_reserved_types(transmission: int) -> None:
    assert download(started(), 0x1400, 2, transmission, 1) == 0x06090030


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
def test_a_deadline_counts_from_the_last_pdo_whatever_is_written_meanwhile(
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


def test_nobody_is_late_whom_nobody_waits_for() -> None:
    application = Log()
    device = started(application)
    assert download(device, 0x1400, 5, 10, 2) == 0
    play(device, f"> {DRIVE}\n+ 10ms\n< {LATE}")
    play(device, "> 620 2B 00 14 05 00 00 00 00\n< 0A0 ..\n< 5A0 60 00 14 05 00 00 00 00")
    assert application.calls == ["rpdo 1", "late 1", "in time 1"]
