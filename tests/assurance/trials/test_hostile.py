"""A hostile third node neither drives the plate nor harms the pair; the trial sees violations."""

from __future__ import annotations

from dataclasses import replace
from random import Random

import pytest

from smarttac_can.assurance.trials.hostile import CALM, OWN, GoodMaster, Hostile, HostileReport
from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.bench.simulation import PLATE_ID
from smarttac_can.vocabulary.states import State

ACTIONS = 1500


@pytest.fixture(scope="module")
def attacked() -> HostileReport:
    return Hostile(ACTIONS, 3).run()


def test_1500_frames_of_every_kind_harm_nothing(attacked: HostileReport) -> None:
    assert attacked.violations == []
    assert set(attacked.actions) == {*CALM, OWN}
    assert sum(attacked.actions.values()) == ACTIONS
    assert attacked.running_share > 0.1
    assert attacked.peak_v <= 150.0
    assert 0.3 < attacked.peak_um <= 7.5
    assert attacked.arms > 1


def test_the_commands_are_2_percent_at_most() -> None:
    assert CALM["NMT or controlword"] <= 0.02 * sum(CALM.values())


def test_it_repeats_by_its_seed() -> None:
    shares: list[float] = []
    first = Hostile(200, 5, shares.append).run()
    assert shares == sorted(shares) and shares[-1] == 1.0
    assert replace(Hostile(200, 5).run(), wall_s=first.wall_s) == first
    assert replace(Hostile(200, 6).run(), seed=5, wall_s=first.wall_s) != first


def test_less_than_an_action_is_refused() -> None:
    with pytest.raises(ValueError, match="actions 0 is below 1"):
        Hostile(0, 1)


def spoil_voltage(hostile: Hostile) -> None:
    hostile._rig.stage.source = lambda: 15_001


def spoil_vibration(hostile: Hostile) -> None:
    plate = hostile._rig.plate_block.plate
    plate._state = plate._state._replace(motion=plate._state.motion._replace(W=7.6e-6 + 0j))


def fail(hostile: Hostile) -> None:
    raise ZeroDivisionError("division by zero")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoil_voltage, "150.01 V at the power stage, more than 150 V"),
        (spoil_vibration, "a vibration of 7.60 um"),
        (fail, "ZeroDivisionError: division by zero"),
    ],
)
def test_attack_trial_reports_each_violation(
    spoil: object, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def observe(hostile: Hostile) -> None:
        spoil(hostile)  # type: ignore[operator]
        honest(hostile)

    honest = Hostile._observe
    monkeypatch.setattr(Hostile, "_observe", observe)
    report = Hostile(3, 1).run()
    assert not report.passed
    assert any(message in line for line in report.violations)


def test_a_limit_that_the_attack_left_at_0_V_is_no_violation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def lower(hostile: Hostile) -> None:
        rig = hostile._rig
        while not (rig.state is State.RUNNING and rig.stage.read()):
            rig.cycle()
            hostile._master.act()
        rig.write("Limit.Voltage", 0)

    monkeypatch.setattr(Hostile, "_attack", lower)
    assert Hostile(3, 1).run().violations == []


@pytest.mark.parametrize("node", ["stimulator", "plate"])
def test_a_node_that_does_not_answer_is_seen(node: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def attack(hostile: Hostile) -> None:
        rig: Rig = hostile._rig
        port = rig.stimulator_port if node == "stimulator" else rig.plate_port
        assert port is not None
        rig.bus.pause(port)
        rig.cycle(5)

    monkeypatch.setattr(Hostile, "_attack", attack)
    assert any("is not alive" in line for line in Hostile(3, 1).run().violations)


def test_an_attack_that_leaves_less_than_half_running_is_seen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Hostile, "_attack", lambda hostile: hostile._rig.cycle(50))
    lines = Hostile(20_000, 1).run().violations
    assert any("running in 0.0 % of the cycles only" in line for line in lines)


def test_its_master_lifts_a_weight_that_is_a_fault() -> None:
    """A weight of 8 N latches a fault, in which no run may be started anew with another finger."""
    rig = Rig()
    rig.start()
    master = GoodMaster(rig, Random(1))
    rig.cycle(300)
    for name, value in (("Finger.Speed", 50), ("Weight.Force x", 8000)):
        rig.master.write(PLATE_ID, rig.plate.od[name], value)
    for _ in range(3000):
        rig.cycle()
        master.act()
    assert rig.plate.od["Weight.Force x"].value == 0
    assert rig.state is State.RUNNING
