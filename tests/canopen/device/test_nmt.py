import pytest
from one_device import NODE_ID, make_device, play, started
from transcript import frame

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.device.service import Application

READ_MODE = "620 40 10 21 00 00 00 00 00"
MODE_IS_0 = "5A0 4F 10 21 00 00 00 00 00"

COMMAND_OF = {
    NMTState.OPERATIONAL: "01",
    NMTState.STOPPED: "02",
    NMTState.PRE_OPERATIONAL: "80",
}


class States(Application):
    def __init__(self) -> None:
        self.seen: list[NMTState] = []

    def on_state(self, state: NMTState) -> None:
        self.seen.append(state)


def test_silent_before_power_on() -> None:
    device = make_device()
    assert device.nmt_state == NMTState.INITIALISING
    play(device, f"> 000 01 20\n> {READ_MODE}\n> 080\n+ 1000ms")


def test_the_application_hears_of_each_change_once() -> None:
    application = States()
    device = started(application, operational=False)
    application.seen.clear()
    play(device, "> 000 80 20\n2x > 000 01 20\n2x > 000 02 20\n> 000 80 20")
    play(device, "> 000 81 20\n< 720 00\n> 000 82 20\n< 720 00")
    assert application.seen == [
        *(NMTState.OPERATIONAL, NMTState.STOPPED, NMTState.PRE_OPERATIONAL),
        *(NMTState.RESET_APPLICATION, NMTState.RESET_COMMUNICATION, NMTState.PRE_OPERATIONAL),
        *(NMTState.RESET_COMMUNICATION, NMTState.PRE_OPERATIONAL),
    ]


@pytest.mark.parametrize(
    "text", ["000 01 21", "000 01", "000 01 20 00", "000 03 20", "000 00 20", "000 rtr", "000"]
)
def test_nmt_ignores_malformed_and_foreign_commands(text: str) -> None:
    device = started(operational=False)
    play(device, f"> {text}")
    assert device.nmt_state == NMTState.PRE_OPERATIONAL


def test_parameters_set_at_reset_hold_from_the_boot_up_on() -> None:
    class Restored(Application):
        def on_state(self, state: NMTState) -> None:
            if state is NMTState.RESET_COMMUNICATION:
                device.od.entry(0x1017).value = 10

    device = make_device(Restored())
    play(device, "power\n< 720 00\n+ 9ms\n+ 1ms\n< 720 7F")
    play(device, "> 000 82 20\n< 720 00\n+ 9ms\n+ 1ms\n< 720 7F")


@pytest.mark.parametrize(
    ("state", "sdo", "sync", "pdo"),
    [
        (NMTState.PRE_OPERATIONAL, True, True, False),
        (NMTState.OPERATIONAL, True, True, True),
        (NMTState.STOPPED, False, False, False),
    ],
)
def test_services_live_in_their_states(state: NMTState, sdo: bool, sync: bool, pdo: bool) -> None:
    class Ticks(Application):
        count = 0

        def on_sync(self) -> bool:
            self.count += 1
            return True

    application = Ticks()
    device = started(application, operational=False)
    device.receive(Frame(0, bytes((int(COMMAND_OF[state], 16), NODE_ID))))

    assert device.receive(frame(READ_MODE)) == ([frame(MODE_IS_0)] if sdo else [])
    for _ in range(3):
        tpdo2 = device.receive(Frame(0x80))
    assert application.count == (3 if sync else 0)
    assert len(tpdo2) == (1 if pdo else 0), "type 3 at the third SYNC"
    device.trigger(3)
    assert len(device.take()) == (1 if pdo else 0)
    device.receive(frame("220 01 00 A0 35 42 00 00 00"))
    assert device.od["Setpoint.Voltage"].value == (1 if pdo else 0)
    device.emergency(0x1234, 0)
    assert len(device.take()) == (1 if sdo else 0)


def test_autostart_after_power_on_and_reset_node_only() -> None:
    device = make_device(autostart=True)
    play(device, "power\n< 720 00")
    assert device.nmt_state == NMTState.OPERATIONAL
    play(device, "> 000 82 20\n< 720 00")
    assert device.nmt_state == NMTState.PRE_OPERATIONAL
    play(device, "> 000 81 20\n< 720 00")
    assert device.nmt_state == NMTState.OPERATIONAL
