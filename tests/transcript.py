"""Transcripts of frames, one event a line, of a device alone or of nodes on a bus.

``power``               power on
``> 000 01 20``         a frame arrives; ``> 1A0 rtr`` is a remote frame
``+ 1000us``            time passes; ``+ 1ms`` is the same
``! 2``                 the application triggers a TPDO
``? 3``                 the bus takes up to three segments
``5x > 080``            any of these five times
``< 720 05``            this is sent, in this order, because of the lines above
``< 720 00 ..``         the same with any data from there on
``# ...``               a remark, also at the end of a line

An unwritten frame must not be sent: `play` asserts it. `written` writes the frames sent instead.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

from smarttac_can.canopen.device.frame import Frame

Act = Callable[[str, str], list[Frame]]
"""Frames sent because of an event: its sign, and the text behind the sign."""

_EVENT = re.compile(r"(?:(\d+)x )?(power|[>+!?])(?: +(.+))?")
_TIME = re.compile(r"(\d+)(us|ms)")


def play(act: Act, text: str) -> None:
    """Let the events of a transcript happen; the frames sent must be its own."""
    sent: list[Frame] = []
    since = "the beginning"
    for number, raw in enumerate(text.splitlines(), 1):
        line = _without_remark(raw)
        if not line:
            continue
        where = f"line {number}: {line}"
        if line.startswith("<"):
            assert sent, f"{where}: nothing was sent"
            _compare(sent.pop(0), line.removeprefix("<"), where)
            continue
        assert not sent, f"after {since}: also sent {_shown(sent)}"
        since = where
        sent = _caused(act, line)
    assert not sent, f"after {since}: also sent {_shown(sent)}"


def written(act: Act, text: str, sent: Iterable[Frame] = ()) -> str:
    """Let the events of a transcript happen, and return it with the frames sent now.

    Frames ``sent`` already stand above the first event.
    """
    lines = [f"< {show(each)}" for each in sent]
    for raw in text.splitlines():
        if not raw or raw.startswith("<"):
            continue
        lines.append(raw)
        line = _without_remark(raw)
        if line:
            lines += [f"< {show(each)}" for each in _caused(act, line)]
    return "\n".join(lines) + "\n"


def frame(text: str) -> Frame:
    can_id, *data = text.split()
    if data == ["rtr"]:
        return Frame(int(can_id, 16), rtr=True)
    return Frame(int(can_id, 16), bytes.fromhex("".join(data)))


def show(sent: Frame) -> str:
    return f"{sent.can_id:03X} {'rtr' if sent.rtr else sent.data.hex(' ').upper()}".rstrip()


def microseconds(text: str) -> int:
    found = _TIME.fullmatch(text)
    assert found is not None, f"{text!r} is no time"
    return int(found[1]) * (1000 if found[2] == "ms" else 1)


def _without_remark(raw: str) -> str:
    return raw.partition("#")[0].strip()


def _caused(act: Act, line: str) -> list[Frame]:
    found = _EVENT.fullmatch(line)
    assert found is not None, f"{line!r} is no event"
    count, sign, what = int(found[1] or 1), found[2], found[3] or ""
    return [sent for _ in range(count) for sent in act(sign, what)]


def _compare(sent: Frame, text: str, where: str) -> None:
    expected = frame(text.removesuffix(".."))
    if text.endswith(".."):
        sent = sent._replace(data=sent.data[: len(expected.data)])
    assert sent == expected, f"{where}: sent {show(sent)}"


def _shown(sent: list[Frame]) -> str:
    return ", ".join(map(show, sent))
