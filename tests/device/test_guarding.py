import pytest
from one_device import download, make_device, play, started

from smarttac_can.device.nmt import NMTState

LIFE_TIME_20_MS = """
    > 620 2B 0C 10 00 0A 00 00 00
    < 5A0 60 0C 10 00 00 00 00 00
    > 620 2F 0D 10 00 02 00 00 00
    < 5A0 60 0D 10 00 00 00 00 00
"""


def test_answers_with_state_and_toggle_bit() -> None:
    play(
        make_device(),
        """
        power
        < 720 00
        > 720 rtr
        < 720 7F
        > 720 rtr
        < 720 FF
        > 000 01 20
        > 720 rtr
        < 720 05
        > 000 02 20
        > 720 rtr
        < 720 84
        > 000 82 20                     # the toggle bit starts with 0 again
        < 720 00
        > 720 rtr
        < 720 7F
        + 1000ms
        """,
    )


def test_heartbeat_and_guarding_exclude_each_other() -> None:
    play(
        started(),
        LIFE_TIME_20_MS
        + """
        > 720 rtr
        < 720 05
        > 620 2B 17 10 00 32 00 00 00   # heartbeat on
        < 720 05
        < 5A0 60 17 10 00 00 00 00 00
        > 720 rtr
        + 49ms                          # nor is the master missed
        + 1ms
        < 720 05
        > 620 2B 17 10 00 00 00 00 00   # and off
        < 5A0 60 17 10 00 00 00 00 00
        > 720 rtr
        < 720 05
        """,
    )


def test_life_guarding_begins_with_the_first_remote_frame() -> None:
    device = started()
    play(
        device,
        LIFE_TIME_20_MS
        + """
        + 100ms
        > 720 rtr
        < 720 05
        + 19ms
        > 720 rtr
        < 720 85
        + 19ms
        + 1ms
        < 0A0 30 81 11 00 00 00 00 00
        + 100ms
        > 720 rtr
        < 720 7F
        < 0A0 00 00 00 00 00 00 00 00
        """,
    )
    assert device.nmt_state is NMTState.PRE_OPERATIONAL


@pytest.mark.parametrize("stricter", ["2B 0C 10 00 08 00 00 00", "2F 0D 10 00 01 00 00 00"])
def test_a_master_that_makes_its_watch_stricter_is_still_missed(stricter: str) -> None:
    device = started()
    play(device, LIFE_TIME_20_MS + "> 720 rtr\n< 720 05")
    play(device, f"> 620 {stricter}\n< 5A0 60 {stricter[3:11]} 00 00 00 00")
    play(device, "+ 16ms\n< 0A0 30 81 11 00 00 00 00 00")


@pytest.mark.parametrize(
    ("behaviour", "state"),
    [(0, NMTState.PRE_OPERATIONAL), (1, NMTState.OPERATIONAL), (2, NMTState.STOPPED)],
)
def test_error_behaviour(behaviour: int, state: NMTState) -> None:
    device = started()
    assert download(device, 0x1029, 1, behaviour, 1) == 0
    play(device, LIFE_TIME_20_MS + "> 720 rtr\n< 720 05\n+ 20ms\n< 0A0 30 81 11 00 00 00 00 00")
    assert device.nmt_state is state


@pytest.mark.parametrize(("guard_time", "factor"), [(10, 0), (0, 3)])
def test_no_life_time_without_both_parameters(guard_time: int, factor: int) -> None:
    device = started()
    download(device, 0x100C, 0, guard_time, 2)
    download(device, 0x100D, 0, factor, 1)
    play(device, "> 720 rtr\n< 720 05\n+ 60000ms")


def test_data_frames_on_its_identifier_are_nothing() -> None:
    play(started(), "> 720 05")
