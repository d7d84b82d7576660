"""Whatever comes from the bus, a device neither fails nor leaves its limits."""

from hypothesis import given, settings
from hypothesis import strategies as st
from one_device import started

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState

INDICES = [
    *(0x1000, 0x1001, 0x1003, 0x1005, 0x1006, 0x1014, 0x1015, 0x1016, 0x1017, 0x1018, 0x1019),
    *(0x1029, 0x1200, 0x1201, 0x1400, 0x1401, 0x1600, 0x1601, 0x1800, 0x1801, 0x1A00, 0x1A01),
    *(0x2000, 0x2007, 0x2008, 0x200A, 0x200D, 0x2012, 0x2100, 0x2110, 0x2112, 0x2300, 0x2301),
]
VALUES = [
    *(0, 1, 2, 3, 0x80, 0xFF, 0xFFFF, 0x80000000, 0xFFFFFFFF, 0x7FC00000, 0x40000080, 0x400001A0),
    *(0xC00001A0, 0x220, 0x80000220, 0x21100008, 0x21000110, 0x21200020, 0x00050008, 0x21000220),
]

expedited = st.builds(
    lambda command, index, subindex, value: Frame(
        0x620,
        bytes((command,)) + index.to_bytes(2, "little") + bytes((subindex,))
        + value.to_bytes(4, "little"),
    ),
    st.sampled_from([0x21, 0x22, 0x23, 0x27, 0x2B, 0x2F, 0x20, 0x40]),
    st.sampled_from(INDICES),
    st.integers(0, 9),
    st.sampled_from(VALUES) | st.integers(0, 0xFFFFFFFF),
)  # fmt: skip
segment = st.builds(
    lambda command, data: Frame(0x620, bytes((command,)) + data),
    st.integers(0, 0xFF),
    st.binary(min_size=7, max_size=7),
)
known = st.builds(
    Frame,
    st.sampled_from([0x000, 0x080, 0x220, 0x320, 0x420, 0x520, 0x1A0, 0x2A0, 0x620, 0x6C0, 0x705]),
    st.binary(max_size=8),
    st.booleans(),
)
nmt = st.builds(
    lambda c: Frame(0, bytes((c, 0x20))), st.sampled_from([1, 1, 1, 2, 0x80, 0x81, 0x82])
)
anything = st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans())
event = st.one_of(expedited, expedited, segment, known, nmt, anything, st.integers(0, 3_000_000))


def hear(events: list[Frame | int], *, operational: bool) -> tuple[Device, list[Frame]]:
    """Let a device hear frames, or time pass in us; return it with all that it sends."""
    device = started(operational=operational)
    sent = []
    for item in events:
        sent += device.advance(item) if isinstance(item, int) else device.receive(item)
        for tpdo in range(1, 7):
            device.trigger(tpdo)
        sent += [*device.take(), *device.segments(9)]
    return device, sent


@given(st.lists(event, max_size=60), st.booleans())
@settings(max_examples=150)
def test_any_traffic(events: list[Frame | int], operational: bool) -> None:
    device, sent = hear(events, operational=operational)
    for frame in sent:
        assert 0 <= frame.can_id <= 0x7FF
        assert len(frame.data) <= 8
    for entry in device.od:
        entry.check(entry.value)
        assert len(entry.pack()) == (entry.size or len(entry.pack()))
    assert device.nmt_state in {NMTState.PRE_OPERATIONAL, NMTState.OPERATIONAL, NMTState.STOPPED}
    assert hear(events, operational=operational)[1] == sent, "the same traffic, the same frames"
    assert Frame(0x720, b"\0") in device.receive(Frame(0, b"\x81\x20"))
    assert all(entry.value == entry.default for entry in device.od)
    assert device.nmt_state is NMTState.PRE_OPERATIONAL
