"""Several bench scripts that talk to one stimulator: each gets the answers to its own questions."""

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import canopen
import pytest
from nodes_on_a_bus import in_threads, stimulator_with_plate

from smarttac_can.bench import BenchError, RefusedError, Stimulator
from smarttac_can.canopen.master.sdo_client import OtherClientError, SharedSdoClient

PAUSES_S = (0.01,) * 5000
"""Before attempts to read a string; all are only made by a test that is about to fail."""


def test_a_driver_that_writes_and_reads_while_others_connect(
    virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    # How often a string is begun anew is up to the pace of the threads.
    monkeypatch.setattr("smarttac_can.canopen.master.sdo_client._PAUSES_S", (0.0, *PAUSES_S))
    over = threading.Event()
    # The refused write of one client is taken back by the next one of either.
    whole = ("", "Setpoint.Voltage 50000 is above 20000")

    def drive(driver: Stimulator) -> None:
        volts = 0
        while not over.wait(0.002):
            volts = (volts + 1) % 50
            driver.voltage = volts
            assert driver.voltage == volts
            with pytest.raises(RefusedError, match=r"voltage 500 V is above 200 V"):
                driver.voltage = 500
            assert driver.message in whole

    with (
        in_threads(virtual, stimulator_with_plate(lockstep=False), lockstep=False),
        Stimulator.connect(**virtual) as driver,
        ThreadPoolExecutor(max_workers=1) as executor,
    ):
        driving = executor.submit(drive, driver)
        try:
            for _ in range(20):
                with Stimulator.connect(**virtual) as reader:
                    reader.amplitude = 1.5
                    assert reader.amplitude == 1.5
                    assert reader.message in whole
        finally:
            over.set()
        driving.result()


class Server(canopen.Network):  # type: ignore[misc]  # python-canopen is untyped
    """Answers each request with the frames it is told to."""

    def __init__(self, *answers: str) -> None:
        super().__init__()
        self.answers = [bytes.fromhex(answer) for answer in answers]
        self.requests = 0

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.requests += 1
        for answer in self.answers:
            self.notify(0x5A0, bytearray(answer), 0.0)


@pytest.mark.parametrize(
    "foreign",
    [
        "4F00200007000000",
        "6000200000000000",
        "6001200000000000",
        "8000200031000906",
        "0100000000000000",
        "8001200000000305",
        "8001200000000405",
        "",
    ],
    ids=[
        *("a read", "a write", "a write of the same", "a refusal", "a segment"),
        *("a toggle error of the same", "a time-out of the same", "nothing"),
    ],
)
def test_answers_to_others_are_not_taken(foreign: str) -> None:
    client = SharedSdoClient(Server(foreign, "4F01200005000000"), 32, 0.0)
    assert client.upload(0x2001, 0) == b"\x05"


def test_the_refusal_of_its_own_request_is_not_repeated() -> None:
    server = Server("8001200001000106")
    with pytest.raises(canopen.SdoAbortedError) as refused:
        SharedSdoClient(server, 32, 0.0).upload(0x2001, 0)
    assert (refused.value.code, server.requests) == (0x06010001, 1)


def test_a_string_that_is_broken_all_the_time(
    virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses: list[float] = []
    monkeypatch.setattr("smarttac_can.canopen.master.sdo_client.sleep", pauses.append)
    server = Server("4101200009000000", "8001200001000405")
    with pytest.raises(OtherClientError):
        SharedSdoClient(server, 32, 0.0).upload(0x2001, 0)
    assert pauses == sorted(pauses)
    assert server.requests == 2 * len(pauses)
    with (
        in_threads(virtual, stimulator_with_plate()),
        Stimulator.connect(**virtual, lockstep=True) as bench,
        monkeypatch.context() as patch,
    ):
        patch.setattr("smarttac_can.canopen.master.sdo_client._PAUSES_S", ())
        with pytest.raises(BenchError, match="another SDO client keeps node 32 busy"):
            assert bench.message
