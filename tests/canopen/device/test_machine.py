"""The whole device against a model of the values to be kept, refused and forgotten."""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from one_device import NODE_ID, download, upload
from read_once import read_once
from rich_eds import RICH

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.device.storage import Memory

SAVE, LOAD = 0x65766173, 0x64616F6C
# Parameters that nothing but SDO changes, with the values they take.
PARAMETERS = {
    (0x100C, 0): (2, range(0x10000)),
    (0x100D, 0): (1, range(0x100)),
    (0x1015, 0): (2, range(0x10000)),
    (0x1017, 0): (2, range(0x10000)),
    (0x1029, 1): (1, range(3)),
    (0x1800, 2): (1, [*range(241), *range(252, 256)]),
    (0x1800, 5): (2, range(0x10000)),
    (0x2F00, 0): (2, range(10, 60_001)),
}
GROUPS = {1: (0, 0xFFFF), 2: (0x1000, 0x1FFF), 3: (0x6000, 0x9FFF), 4: (0x2000, 0x5FFF)}
SERVER = 0x600 + NODE_ID
CLIENT = 0x580 + NODE_ID
addresses = st.sampled_from(sorted(PARAMETERS))


class DeviceMachine(RuleBasedStateMachine):
    @initialize()
    def power_on(self) -> None:
        self.device = Device(read_once(RICH, NODE_ID), storage=Memory())
        self.defaults = {a: self.device.od.number(*a) for a in PARAMETERS}
        self.stored: dict[tuple[int, int], int] = {}
        self.cycle_power()

    @rule()
    def cycle_power(self) -> None:
        assert self.device.start() == [Frame(0x700 + NODE_ID, b"\0")]
        self.values = self.defaults | self.stored
        self.state = NMTState.PRE_OPERATIONAL

    @rule(state=st.sampled_from([1, 2, 0x80]), everyone=st.booleans())
    def command(self, state: int, everyone: bool) -> None:
        self.device.receive(Frame(0, bytes((state, 0 if everyone else NODE_ID))))
        self.state = {
            1: NMTState.OPERATIONAL,
            2: NMTState.STOPPED,
            0x80: NMTState.PRE_OPERATIONAL,
        }[state]

    @rule(communication=st.booleans())
    def reset(self, communication: bool) -> None:
        sent = self.device.receive(Frame(0, bytes((0x81 + communication, NODE_ID))))
        assert Frame(0x700 + NODE_ID, b"\0") in sent
        fresh = self.defaults | self.stored
        for address in self.values:
            if not communication or 0x1000 <= address[0] <= 0x1FFF:
                self.values[address] = fresh[address]
        self.state = NMTState.PRE_OPERATIONAL

    @precondition(lambda self: self.state is not NMTState.STOPPED)
    @rule(address=addresses, value=st.integers(0, 0xFFFF) | st.integers(0, 260))
    def write(self, address: tuple[int, int], value: int) -> None:
        size, allowed = PARAMETERS[address]
        value &= (1 << 8 * size) - 1
        accepted = download(self.device, *address, value, size) == 0
        assert accepted == (value in allowed or value == self.values[address])
        if accepted:
            self.values[address] = value

    @precondition(lambda self: self.state is not NMTState.STOPPED)
    @rule(address=addresses)
    def read(self, address: tuple[int, int]) -> None:
        data = upload(self.device, *address)
        assert data == self.values[address].to_bytes(PARAMETERS[address][0], "little")

    @precondition(lambda self: self.state is not NMTState.STOPPED)
    @rule(group=st.sampled_from(sorted(GROUPS)), load=st.booleans())
    def store(self, group: int, load: bool) -> None:
        first, last = GROUPS[group]
        signature = LOAD if load else SAVE
        assert download(self.device, 0x1010 + load, group, signature, 4) == 0
        for address, value in self.values.items():
            if first <= address[0] <= last:
                self.stored.pop(address, None)
                if not load:
                    self.stored[address] = value

    @rule(data=st.binary(min_size=8, max_size=8))
    def abandon_a_transfer(self, data: bytes) -> None:
        """Begin a block download of the domain, go on with anything, and leave."""
        start = bytes.fromhex("c000230000000000")
        sent = self.device.receive(Frame(SERVER, start))
        if self.state is NMTState.STOPPED:
            assert not sent
            return
        assert sent[-1].data[0] == 0xA4
        self.device.receive(Frame(SERVER, bytes((data[0] & 0x7F | 1,)) + data[1:]))
        self.advance(60_000)
        self.advance(60_000)

    @rule(milliseconds=st.integers(0, 5000))
    def advance(self, milliseconds: int) -> None:
        for frame in self.device.advance(1000 * milliseconds):
            if frame.can_id == 0x700 + NODE_ID:
                assert self.values[0x1017, 0]
                assert frame.data == bytes((self.state,))
            elif frame.can_id in (CLIENT, 0x080 + NODE_ID):
                # An emergency of a SYNC of the wrong length waits for its inhibit time.
                assert self.state is not NMTState.STOPPED
            else:
                assert self.state is NMTState.OPERATIONAL

    @rule(counter=st.booleans(), number=st.integers(1, 6))
    def synchronise(self, counter: bool, number: int) -> None:
        self.device.trigger(number)
        sent = self.device.take() + self.device.receive(Frame(0x080, b"\1" * counter))
        sent = [frame for frame in sent if frame.can_id != 0x080 + NODE_ID]
        assert not sent or self.state is NMTState.OPERATIONAL

    @rule()
    def guard(self) -> None:
        sent = self.device.receive(Frame(0x700 + NODE_ID, rtr=True))
        assert len(sent) == (not self.values[0x1017, 0])
        assert all(frame.data[0] & 0x7F == self.state for frame in sent)
        if self.values[0x100C, 0] * self.values[0x100D, 0]:
            # Life guarding is on: later frames without guarding may change the state.
            self.device.receive(Frame(0, bytes((0x82, NODE_ID))))
            fresh = self.defaults | self.stored
            self.values |= {a: fresh[a] for a in self.values if a[0] < 0x2000}
            self.state = NMTState.PRE_OPERATIONAL

    @invariant()
    def is_sound(self) -> None:
        if not hasattr(self, "device"):
            return
        assert self.device.nmt_state is self.state
        for entry in self.device.od:
            entry.check(entry.value)
        assert {a: self.device.od.number(*a) for a in self.values} == self.values


TestDeviceMachine = DeviceMachine.TestCase
TestDeviceMachine.settings = settings(max_examples=60, stateful_step_count=40)
