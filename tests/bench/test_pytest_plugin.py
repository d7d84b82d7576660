"""The fixtures that come with the package, as a user's own tests take them."""

from typing import Any

import can
import pytest

from smarttac_can.bench import Stimulator

pytest_plugins = ("pytester",)


def test_the_stimulator_is_ready(stimulator: Stimulator) -> None:
    stimulator.finger.stroke(1)
    stimulator.start_run()
    stimulator.tare()
    stimulator.amplitude = 1.0
    stimulator.mode = "amplitude resonance"
    assert abs(stimulator.run(0.1).amplitude_um[-1] - 1.0) < 0.05


def test_another_party_on_its_bus(smarttac_bus: dict[str, Any], stimulator: Stimulator) -> None:
    with can.Bus(**smarttac_bus) as listener:
        stimulator.run(0.01)
        heard = {message.arbitration_id for message in iter(lambda: listener.recv(0.0), None)}
    assert heard >= {0x80, 0x2A0}


def test_each_test_has_a_bus_of_its_own(smarttac_bus: dict[str, Any]) -> None:
    with can.Bus(**smarttac_bus) as listener:
        assert listener.recv(0.0) is None


def test_in_a_project_of_its_own(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        def test_run(stimulator):
            assert len(stimulator.run(0.05)) == 50

        def test_same_again(stimulator):
            assert stimulator.run(0.05).tick[0] == 0
        """
    )
    result = pytester.runpytest_subprocess("-W", "error", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=2)


def test_an_error_of_the_node_is_an_error_of_the_test(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        from smarttac_can.nodes.stimulator_node import StimulatorNode

        def test_run(monkeypatch, smarttac_bus):
            def broken(self):
                raise RuntimeError("the node broke")
            monkeypatch.setattr(StimulatorNode, "shutdown", broken)
        """
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(passed=1, errors=1)
    result.stdout.fnmatch_lines(["*RuntimeError: the node broke"])
