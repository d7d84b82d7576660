"""The fixtures that come with the package, as a user's own tests take them.

The tests with the fixture ``bench`` drive the fixture ``stimulator`` as one of its links.
"""

from collections.abc import Callable
from typing import Any

import can
import pytest

from smarttac_can.bench import BenchError, Stimulator

Make = Callable[..., Stimulator]

pytest_plugins = ("pytester",)


def test_another_party_on_its_bus(smarttac_bus: dict[str, Any], stimulator: Stimulator) -> None:
    with can.Bus(**smarttac_bus) as listener:
        stimulator.run(0.01)
        heard = {message.arbitration_id for message in iter(lambda: listener.recv(0.0), None)}
    assert heard >= {0x80, 0x2A0}


def test_in_a_project_of_its_own(pytester: pytest.Pytester) -> None:
    """In which an error of the node is an error of its test."""
    pytester.makepyfile(
        """
        from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode

        def test_run(stimulator):
            assert len(stimulator.run(0.05)) == 50

        def test_same_again(stimulator):
            assert stimulator.run(0.05).tick[0] == 0

        def test_node_that_breaks(monkeypatch, smarttac_bus):
            def broken(self):
                raise RuntimeError("the node broke")
            monkeypatch.setattr(StimulatorNode, "shutdown", broken)
        """
    )
    result = pytester.runpytest_subprocess("-W", "error", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=3, errors=1)
    result.stdout.fnmatch_lines(
        ["*ERROR at teardown of test_node_that_breaks*", "*RuntimeError: the node broke"]
    )


@pytest.mark.parametrize("inside", [True, False])
def test_make_stimulator_applies_its_options(make_stimulator: Make, inside: bool) -> None:
    bench = make_stimulator(subject=3, seed=7, plate_inside=inside)
    assert (bench.get("Simulation.Subject"), bench.get("Simulation.Seed")) == (3, 7)
    with Stimulator.simulate("local", subject=3, seed=7) as same:
        one, other = bench.run(0.05), same.run(0.05)
    assert one.normal_force_n.tolist() == other.normal_force_n.tolist()


def test_several_instruments_do_not_hear_each_other(make_stimulator: Make) -> None:
    first, second = make_stimulator(seed=1), make_stimulator(seed=2)
    for bench in (first, second):
        bench.tare()
    first.amplitude, first.mode = 1.0, "amplitude"
    assert first.run(0.05).voltage_v[-1] > 10
    assert second.run(0.05).voltage_v.max() == 0.0


@pytest.mark.parametrize(
    "options",
    [{"subject": 10}, {"seed": -1}, {"presets": {"Nope": 1}}, {"plate_inside": "no"}],
)
def test_make_stimulator_refuses_unknown_options(
    make_stimulator: Make, options: dict[str, Any]
) -> None:
    with pytest.raises((ValueError, BenchError)):
        make_stimulator(**options)
