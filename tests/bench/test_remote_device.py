"""The node-ID of a bench's heartbeat; what it is for is tested with processes."""

from smarttac_can.bench.remote_device import bench_id


def test_a_node_id_of_its_own_for_each_of_16_stimulators_in_a_row() -> None:
    assert bench_id(32) == 127
    for first in range(1, 112):
        ids = [bench_id(node_id) for node_id in range(first, first + 16)]
        assert sorted(ids) == list(range(112, 128))


def test_never_that_of_the_stimulator() -> None:
    assert all(bench_id(node_id) != node_id for node_id in range(1, 128))
