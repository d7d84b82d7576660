"""A device that was never given a node-ID, from the command line to its life with one."""

from pathlib import Path

import pytest
from click.testing import CliRunner
from nodes_on_a_bus import NodeProcess, multicast_options

from smarttac_can.cli import main

EDS = Path(__file__).parents[1] / "eds" / "rich.eds"


@pytest.mark.parametrize("command", [("node",), ("plate",), ("device", "--eds", str(EDS))])
def test_unconfigured_and_a_node_id_contradict_each_other(command):
    result = CliRunner().invoke(main, [*command, "--unconfigured", "--node-id", "5"])
    assert result.exit_code == 2
    assert "--unconfigured has no --node-id, but 5 is given" in result.stderr


def test_lss_gives_the_node_id_and_storage_keeps_it(multicast, tmp_path):
    bus = multicast_options(multicast)
    where = f"udp_multicast:{multicast['channel']}"
    command = ["device", "--eds", str(EDS), "--unconfigured", "--storage", str(tmp_path / "kept")]
    first = NodeProcess(*command, *bus)
    try:
        first.wait_for(f"device without node-ID ready on {where}")
        given = CliRunner().invoke(main, ["lss", "9", "--store", *bus])
        assert given.exit_code == 0, given.stderr
        first.wait_for("device 9 pre-operational")
    finally:
        status, said, _ = first.end()
    assert (status, said[-1]) == (0, "device 9 stopped")
    second = NodeProcess(*command, *bus)
    try:
        second.wait_for(f"device 9 ready on {where}")
    finally:
        second.end()
