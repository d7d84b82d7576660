"""An interface that goes down and up again under a node that drives."""

from __future__ import annotations

import subprocess
import time

import pytest
from processes import CHANNEL, NodeProcess

from smarttac_can.bench import BusLostError, FaultError, Mode, Stimulator


def switch(state: str) -> None:
    subprocess.run(["ip", "link", "set", CHANNEL, state], check=True)


def connect() -> Stimulator:
    return Stimulator.connect(interface="socketcan", channel=CHANNEL, lockstep=True)


# python-can ends the receiving of the bench, which shares the interface, by raising in its thread.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_the_node_goes_to_0_v_lives_on_and_comes_back() -> None:
    with NodeProcess("node") as node:
        assert node.process.stdout is not None
        said = [""]
        with pytest.raises(BusLostError, match="the bus has failed"), connect() as bench:
            bench.run(0.1)
            bench.voltage = 20
            bench.mode = Mode.OPEN_LOOP
            assert bench.run(0.02).voltage_v[-1] == 20.0
            switch("down")
            try:
                while "lost socketcan:vcan0, at 0 V" not in said[-1]:
                    said.append(node.process.stdout.readline())
                    assert said[-1], said
                # SocketCAN lets it be opened meanwhile: that is not being back.
                time.sleep(1.5)
            finally:
                switch("up")
            bench.run(0.01)
        while "back on socketcan:vcan0" not in said[-1]:
            said.append(node.process.stdout.readline())
            assert said[-1], said
        with connect() as bench:
            with pytest.raises(FaultError, match="the CAN controller is bus-off") as told:
                bench.run(0.02)
            assert told.value.trace is not None
            assert told.value.trace.voltage_v.max() == 0.0
        assert node.terminate() == 0
        said += node.said
        assert sum("lost" in line for line in said) == 1
        assert sum("back" in line for line in said) == 1
