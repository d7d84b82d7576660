"""Whatever ends the stimulator's process, the plate is left at 0 V."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import can
import canopen
import pytest
from processes import CHANNEL, GUARD_S, PLATE_ID, NodeProcess

from smarttac_can.bench import HeartbeatLostError, Mode, Stimulator
from smarttac_can.canopen.od import cia
from smarttac_can.host.files import packaged_eds

DEADLINE_CYCLES = 3
"""Cycles without a drive after which a plate is at 0 V."""


@pytest.fixture
def plate() -> Iterator[NodeProcess]:
    with NodeProcess("plate") as process:
        yield process


@pytest.fixture
def stimulator(plate: NodeProcess) -> Iterator[NodeProcess]:
    with NodeProcess("node", "--plate-node", str(PLATE_ID)) as process:
        yield process


def drive(bench: Stimulator) -> None:
    bench.voltage = 20
    bench.mode = Mode.OPEN_LOOP
    bench.run(0.02)


def stage_voltage() -> int:
    """Ask the plate over SDO, as any master would."""
    network = canopen.Network()
    network.connect(interface="socketcan", channel=CHANNEL)
    try:
        node = network.add_node(PLATE_ID, str(packaged_eds("plate.eds")))
        node.sdo.RESPONSE_TIMEOUT = GUARD_S
        return int(node.sdo["Stage"]["Voltage [10 mV]"].raw)
    finally:
        network.disconnect()


def connect(timeout: float = 3.0) -> Stimulator:
    return Stimulator.connect(
        interface="socketcan",
        channel=CHANNEL,
        plate_node_id=PLATE_ID,
        lockstep=True,
        timeout=timeout,
    )


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGXCPU], ids=lambda n: n.name
)
def test_stimulator_told_to_stop(
    number: signal.Signals, plate: NodeProcess, stimulator: NodeProcess
) -> None:
    with pytest.raises(HeartbeatLostError, match="node 32 does not answer"), connect() as bench:
        drive(bench)
        assert stage_voltage() == 2000
        stimulator.process.send_signal(number)
        assert stimulator.ended() == 0
        assert stimulator.said[-1] == "stimulator 32 stopped at 0 V"
        assert stage_voltage() == 0
    assert plate.terminate() == 0


def test_stimulator_killed(plate: NodeProcess, stimulator: NodeProcess) -> None:
    with pytest.raises(HeartbeatLostError, match="node 32 does not answer"), connect() as bench:
        drive(bench)
        stimulator.process.kill()
        stimulator.ended()
        assert stage_voltage() == 2000, "no time has passed for the plate"
        with can.Bus(channel=CHANNEL, interface="socketcan") as bus:
            for _ in range(DEADLINE_CYCLES):
                bus.send(can.Message(arbitration_id=cia.SYNC_ID, is_extended_id=False))
        assert stage_voltage() == 0
    assert plate.terminate() == 0
