import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import toy_node
from conftest import GROUP
from toy_node import BOOT_UP, OFF

from smarttac_can.device.frame import Frame
from smarttac_can.host.process_signals import stop_on_signals
from smarttac_can.host.python_can import PythonCanBus

SIGNALS = [signal.SIGINT, signal.SIGTERM]


@pytest.mark.parametrize("number", SIGNALS)
def test_signal_is_remembered_and_handlers_come_back(number: signal.Signals) -> None:
    before = [signal.getsignal(n) for n in SIGNALS]
    with stop_on_signals() as stop:
        assert not stop()
        signal.raise_signal(number)
        assert stop()
        signal.raise_signal(number)
        assert stop()
    assert [signal.getsignal(n) for n in SIGNALS] == before


def test_handlers_come_back_after_an_error() -> None:
    before = [signal.getsignal(n) for n in SIGNALS]
    with pytest.raises(ZeroDivisionError), stop_on_signals():
        raise ZeroDivisionError
    assert [signal.getsignal(n) for n in SIGNALS] == before


@pytest.mark.parametrize("number", SIGNALS)
def test_process_told_to_stop_says_zero_volts_and_ends_well(
    number: signal.Signals, multicast_port: int
) -> None:
    def wait_for(can_id: int) -> Frame | None:
        frame = master.receive(20)
        while frame is not None and frame.can_id != can_id:
            frame = master.receive(20)
        return frame

    master = PythonCanBus("udp_multicast", GROUP, port=multicast_port)
    root = Path(toy_node.__file__).parents[2]
    node = subprocess.Popen(
        [sys.executable, toy_node.__file__, GROUP, str(multicast_port)],
        env={**os.environ, "PYTHONPATH": str(root)},
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert wait_for(BOOT_UP + 1) is not None
        node.send_signal(number)
        assert wait_for(OFF + 1) == Frame(OFF + 1, bytes(2))
        _, errors = node.communicate(timeout=20)
        assert (node.returncode, errors) == (0, "")
    finally:
        node.kill()
        node.communicate()
        master.close()
