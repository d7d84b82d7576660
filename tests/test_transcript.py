"""The language of the transcripts: an unwritten frame must not be sent."""

import pytest
from transcript import frame, microseconds, play, show, written

from smarttac_can.canopen.device.frame import Frame

BOOT_UP = Frame(0x720, b"\0")


def echo(sign: str, what: str) -> list[Frame]:
    """Answers a frame by the same, and a power-on by a boot-up; says nothing as time passes."""
    return [frame(what)] if sign == ">" else [BOOT_UP] if sign == "power" else []


@pytest.mark.parametrize(
    "text",
    [
        "power\n< 720 00",
        "2x > 1A0 0102 # a remark\n# another\n\n  < 1A0 01 02\n< 1a0 01 ..",
        "> 1A0 rtr\n< 1A0 rtr",
        "> 080\n< 080\n3x + 1ms",
    ],
)
def test_transcript_expects_each_written_frame(text: str) -> None:
    play(echo, text)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("power", "after line 1: power: also sent 720 00"),
        ("power\n+ 1ms", "after line 1: power: also sent 720 00"),
        ("< 720 00", "line 1: < 720 00: nothing was sent"),
        ("> 080\n< 080 01", "line 2: < 080 01: sent 080"),
        ("> 1A0 rtr\n< 1A0", "line 2: < 1A0: sent 1A0 rtr"),
        ("> 1A0 02 03\n< 1A0 01 ..", "line 2: < 1A0 01 ..: sent 1A0 02"),
        ("2 > 080", "'2 > 080' is no event"),
    ],
)
def test_transcript_reports_each_difference(text: str, why: str) -> None:
    with pytest.raises(AssertionError, match=f"^{why}"):
        play(echo, text)


def test_transcript_update_writes_the_frames_sent_now() -> None:
    events = "# first\n2x > 1A0 01 0f\n< 1A0 00\n+ 1ms # quiet\n"
    now = "< 720 00\n# first\n2x > 1A0 01 0f\n< 1A0 01 0F\n< 1A0 01 0F\n+ 1ms # quiet\n"
    assert written(echo, events, [BOOT_UP]) == now
    assert written(echo, now, [BOOT_UP]) == now


def test_frames_and_times() -> None:
    assert show(frame("080")) == "080"
    assert frame("1A0 01 02") == Frame(0x1A0, b"\1\2")
    assert [microseconds("7us"), microseconds("2ms")] == [7, 2000]
    with pytest.raises(AssertionError, match="'2s' is no time"):
        microseconds("2s")
