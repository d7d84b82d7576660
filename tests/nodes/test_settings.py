"""A write to one object changes what depends on it, and costs no more than that."""

from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.control import design
from smarttac_can.nodes.loop_watchdogs import LoopWatchdogs
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.plans import (
    DESIGN,
    cascade_parameters,
    keep_model,
    plate_model,
    with_change,
)
from smarttac_can.nodes.stimulator_block import StimulatorBlock
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import Control

OD = stimulator_od()
SETTINGS = [
    entry for entry in OD if entry.writable and entry.name.partition(".")[0] in DESIGN
]  # fmt: skip


@given(
    st.lists(
        st.sampled_from(SETTINGS).flatmap(
            lambda entry: st.tuples(
                st.just(entry), st.integers(int(entry.low), int(min(entry.high, 2**31 - 1)))
            )
        ),
        max_size=20,
    )
)
def test_one_change_after_the_other_is_what_all_objects_say(
    changes: list[tuple[Entry, int]],
) -> None:
    OD.reset()
    parameters = cascade_parameters(OD)
    for entry, raw in changes:
        before = entry.value
        try:
            parameters = with_change(parameters, OD, entry, raw)
        except Abort as abort:
            assert abort.code == AbortCode.VALUE
            entry.value = raw
            with pytest.raises(Abort):
                cascade_parameters(OD)
            entry.value = before
        else:
            entry.value = raw
        assert parameters == cascade_parameters(OD)


@pytest.mark.parametrize(
    ("name", "raw"),
    [("Limit.Lowest frequency", 4_400_001), ("Limit.Highest frequency", 4_269_999)],
)
def test_limits_that_contradict_each_other_are_refused(name: str, raw: int) -> None:
    OD.reset()
    with pytest.raises(Abort) as refused:
        with_change(cascade_parameters(OD), OD, OD[name], raw)
    assert refused.value.code == AbortCode.VALUE


def driving() -> StimulatorBlock:
    """A loop with the plate inside that tracks amplitude and resonance."""
    block = StimulatorBlock(stimulator_od(), PlateBlock(plate_od()))
    for _ in range(70):
        block.tick()
    for name, raw in (
        ("Setpoint.Amplitude", 1000),
        ("Controlword", Control.ARM),
        ("Controlword", Control.ARM | Control.RUN),
        ("Mode", Mode.AMPLITUDE_RESONANCE),
    ):
        block.write(name, raw)
    for _ in range(100):
        block.tick()
    return block


@pytest.mark.parametrize(
    ("name", "raw"),
    [
        ("Limit.Voltage", 14_000),
        ("Limit.Amplitude", 2900),
        ("Limit.Lowest frequency", 4_271_000),
        ("Limit.Temperature", 5900),
        ("Limit.Lateral force", 2900),
        ("Controller.Friction slope per percent", 41),
        ("Controller.Boundary hysteresis", 90),
        ("Friction law", 1),
    ],
)
def test_a_limit_costs_a_limit(name: str, raw: int) -> None:
    block = driving()
    looked_up: list[str] = []
    find = ObjectDictionary.__getitem__

    def counted(od: ObjectDictionary, wanted: str) -> object:
        looked_up.append(wanted)
        return find(od, wanted)

    with patch.object(ObjectDictionary, "__getitem__", counted):
        block.write(name, raw)
    assert looked_up == [name]
    with patch.object(design, "_pi", side_effect=AssertionError("designed anew")):
        block.tick()
    assert block.cascade.parameters == cascade_parameters(block.od)


@pytest.mark.parametrize("name", ["Controller.Amplitude pole", "Controller.Dead time"])
def test_what_the_design_follows_from_makes_another(name: str) -> None:
    block = driving()
    block.write(name, 250)
    before = block.cascade.plan
    block.tick()
    assert block.cascade.plan.bare != before.bare


def test_limits_that_cut_nothing_off_leave_the_drive_as_it_is_to_the_bit() -> None:
    disturbed, left_alone = driving(), driving()
    for k in range(100):
        disturbed.write("Limit.Voltage", 14_000 - k)
        disturbed.write("Limit.Highest frequency", 4_390_000 - k)
        disturbed.write("Limit.Normal force", 3900 - k)
        disturbed.tick()
        left_alone.tick()
        assert disturbed.cascade.drive == left_alone.cascade.drive
        assert disturbed.cascade.drive.voltage > 0.0


def test_a_frequency_in_force_is_cut_to_new_limits() -> None:
    block = driving()
    block.write("Limit.Lowest frequency", 4_390_000)
    block.tick()
    assert block.cascade.mode is Mode.AMPLITUDE_RESONANCE
    assert block.cascade.drive.frequency == pytest.approx(43900.0, abs=1.0)
    block.write("Setpoint.Amplitude", 0)
    for _ in range(30):
        block.tick()
    block.write("Limit.Lowest frequency", 4_395_000)
    block.tick()
    assert block.cascade.mode is Mode.AMPLITUDE_RESONANCE, block.cascade.reason
    assert block.cascade.drive.frequency == pytest.approx(43950.0), "held, without a vibration"


def test_the_watchdogs_follow_their_records_alone() -> None:
    block = driving()
    with patch.object(LoopWatchdogs, "configure", autospec=True) as configure:
        block.write("Controller.Contact force", 110)
        block.tick()
        assert configure.call_count == 0
        for name, raw in (
            ("Limit.Normal force", 3900),
            ("Model.Tau", 9000),
        ):
            if name.startswith("Model"):
                block.write("Controlword", 0)
            configure.reset_mock()
            block.write(name, raw)
            block.tick()
            assert configure.call_count == 1, name


def test_an_identification_is_kept_with_its_temperature_and_leaves_the_load() -> None:
    od = stimulator_od()
    od["Model.Load"].value = 1300
    model = PlateModel(51e-9, 0.9e-3, 43_250.0, load=1.3, temperature=29.503)
    keep_model(od, model)
    assert plate_model(od) == PlateModel(51e-9, 0.9e-3, 43_250.0, 1.3, 29.5)
    assert (od["Model.Load"].value, od["Model.Temperature"].value) == (1300, 2950)
