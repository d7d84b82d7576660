"""Plans are built as they are after a write, before it is accepted."""

from unittest.mock import patch

import pytest
from driven import driven, write, write_entry
from hypothesis import given
from hypothesis import strategies as st
from inside import Loop

from smarttac_can.bench.simulation import STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.canopen.od.cia import Abort, AbortCode, NMTCommand
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.instrument.nodes.parameters import (
    DESIGN,
    GAUGE_ZERO,
    MODEL,
    UNTARED,
    ModelSheet,
    Plans,
    Present,
    build_plans,
    keep_model,
    plate_model,
)
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.science.control import design
from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.identification import Identification
from smarttac_can.science.control.texture import NO_TEXTURE
from smarttac_can.vocabulary.meanings import AUTO_ZERO, ZERO
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.states import IdentificationState, Mode

OD = stimulator_od()
SETTINGS = [
    entry
    for entry in OD
    if entry.writable and entry.name.partition(".")[0] in (*DESIGN, MODEL, GAUGE_ZERO)
]


def built(od: ObjectDictionary, written: Entry | None = None, raw: int = 0) -> Plans:
    return build_plans(od, Present(plate_model(od), UNTARED, NO_TEXTURE, 3), written, raw)


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
def test_a_plan_before_a_write_is_that_of_all_objects_after_it(
    changes: list[tuple[Entry, int]],
) -> None:
    OD.reset()
    for entry, raw in changes:
        before, model = entry.value, plate_model(OD)
        present = Present(model, UNTARED, NO_TEXTURE, 3)
        try:
            plans = build_plans(OD, present, entry, raw)
        except Abort as abort:
            assert abort.code == AbortCode.VALUE
            entry.value = raw
            with pytest.raises(Abort):
                built(OD)
            entry.value = before
        else:
            entry.value = raw
            assert plans == build_plans(OD, present)


def fields_of(plans: Plans) -> dict[str, object]:
    """The fields of both plans, and those of the bounds of the vibration, by name."""
    control, watch = plans.control, plans.watch
    return {
        **{f"control.{name}": value for name, value in control._asdict().items()},
        **{f"watch.{name}": value for name, value in watch._asdict().items() if name != "bound"},
        **{f"bound.{name}": value for name, value in watch.bound._asdict().items()},
    }


FOLLOWS = {
    "Friction law": "control.law",
    "Controller.Amplitude pole": "control.bare control.inverse control.rows",
    "Controller.Resonance pole": "control.bare control.rows",
    "Controller.Friction slope per percent": "control.slope",
    "Controller.Friction step limit": "control.step_max",
    "Controller.Contact force": "control.gauging",
    "Controller.Boundary hysteresis": "control.half",
    "Controller.Dead time": "control.ahead control.bare control.inverse control.rows "
    "control.prior",
    "Controller.Vibration law": "control.inverse control.vibration_law",
    "Limit.Voltage": "control.V_max watch.V_max",
    "Limit.Amplitude": "control.W_max",
    "Limit.Lowest frequency": "control.f_min watch.f_min",
    "Limit.Highest frequency": "control.f_max watch.f_max",
    "Limit.Amplitude trip": "bound.trip",
    "Limit.Temperature": "watch.temperature_max",
    "Limit.Normal force": "watch.Fn_max",
    "Limit.Lateral force": "watch.Ft_max",
    "Limit.Gauge mismatch": "watch.mismatch",
    "Limit.Amplitude by drive": "bound.limit bound.bare_limit",
    # Looked at once a second, not in a cycle.
    "Limit.Missed ticks": "",
    "Model.Gain per volt": "control.bare control.rows control.prior control.gain "
    "bound.identified bound.gain bound.most_gain",
    "Model.Tau": "control.bare control.rows control.prior "
    "bound.identified bound.tau bound.decay bound.most_gain bound.believed_tau",
    "Model.Resonance": "control.prior bound.identified bound.most_gain bound.f0",
    "Model.Load": "control.rows control.prior bound.identified bound.most_gain",
    "Model.Temperature": "control.prior bound.identified bound.most_gain bound.found_at",
    "Model.Softening": "control.prior bound.identified bound.most_gain bound.softest",
    "Model.Data sheet gain per volt": "bound.most_gain",
    "Model.Data sheet tau": "bound.believed_tau",
    "Model.Data sheet tolerance": "bound.most_gain bound.believed_tau",
    **dict.fromkeys([f"Calibration.{axis} from {s}" for axis in ("Fx", "Fy") for s in ("S1", "S2")],
                    "control.gauging"),
    **dict.fromkeys([f"Calibration.Position of S{n}" for n in range(3, 7)],
                    "control.gauging watch.gauge_positions"),
    "Calibration.Plate serial number": "watch.serial",
    **dict.fromkeys(["Calibration.COF uncertainty", "Calibration.COF uncertainty per K",
                     "Calibration.Null drift", "Calibration.Temperature"], "control.gauging"),
    **dict.fromkeys([f"Gauge zero.Zero of S{n}" for n in range(1, 7)], "control.zero"),
    **dict.fromkeys([f"Mode shape.{name}" for name in ("Node distance", "Cosine", "Sine")],
                    "control.mode_shape"),
    # Which of no tables does not matter.
    "Texture.Slot": "",
    "Texture.Preview": "control.ahead",
}  # fmt: skip
"""Plans that follow from a parameter."""


def prepared(od: ObjectDictionary, entry: Entry) -> int:
    """Prepare the others so that a parameter makes a difference; return another value for it."""
    od["Gauge zero.Zero of S2"].value = od["Gauge zero.Zero of S3"].value = 100
    if entry.name.startswith("Model.Data sheet"):
        od["Model.Gain per volt"].value = 30_000
        od["Model.Tau"].value = 5_000
    if "frequency" in entry.name:
        return int(entry.value) + 1
    return int(entry.low if entry.value != entry.low else entry.high)


@pytest.mark.parametrize("entry", SETTINGS, ids=lambda entry: entry.name)
def test_each_parameter_changes_its_plans(entry: Entry) -> None:
    """One that is not followed any more turns this red."""
    OD.reset()
    raw = prepared(OD, entry)
    OD["Model.State"].value = 2
    before, after = fields_of(built(OD)), fields_of(built(OD, entry, raw))
    changed = {name for name in before if before[name] != after[name]}
    assert changed == set(FOLLOWS[entry.name].split())


def driving() -> StimulatorBlock:
    """A loop with the plate inside that tracks amplitude and resonance."""
    loop = Loop()
    assert loop.write("Setpoint.Amplitude", 1000) == 0
    loop.run(Mode.AMPLITUDE_RESONANCE)
    loop.tick(100)
    return loop.block


@pytest.mark.parametrize(
    ("name", "raw"),
    [
        ("Limit.Voltage", 14_000),
        ("Limit.Amplitude", 2900),
        ("Limit.Lowest frequency", 4_271_000),
        ("Limit.Temperature", 5900),
        ("Limit.Normal force", 3900),
        ("Limit.Lateral force", 2900),
        ("Controller.Friction slope per percent", 41),
        ("Controller.Boundary hysteresis", 90),
        ("Friction law", 1),
    ],
)
def test_write_holds_from_the_next_cycle_without_a_new_design(name: str, raw: int) -> None:
    block = driving()
    control, watch = block.cascade.plan, block.supervisor.plan
    integrators = block.cascade.state.loops
    with patch.object(design, "_pi", side_effect=AssertionError("designed anew")):
        block.write(name, raw)
        assert (block.cascade.plan, block.supervisor.plan) == (control, watch)
        assert block.cascade.state.loops == integrators
        block.tick()
    expected = built(block.od, None)
    assert block.cascade.parameters == expected.parameters
    assert block.cascade.plan == expected.control
    assert block.supervisor.plan == expected.watch
    assert (block.cascade.plan, block.supervisor.plan) != (control, watch)


def test_a_write_that_is_refused_leaves_the_plans() -> None:
    block = driving()
    control, watch = block.cascade.plan, block.supervisor.plan
    with pytest.raises(Abort):
        block.write("Limit.Lowest frequency", 4_400_001)
    block.tick()
    assert (block.cascade.plan, block.supervisor.plan) == (control, watch)


@pytest.mark.parametrize("entry", SETTINGS, ids=lambda entry: entry.name)
def test_a_new_run_and_a_reset_build_all_plans_anew(entry: Entry) -> None:
    """The values of the objects count, however they came there."""
    block = StimulatorBlock(stimulator_od(), PlateBlock(plate_od()))

    def in_force() -> tuple[object, object]:
        return block.cascade.plan, block.supervisor.plan

    default = in_force()
    raw = prepared(block.od, block.od[entry.name])
    block.start_run()
    before = in_force()
    block.od[entry.name].value = raw
    block.start_run()
    expected = built(block.od)
    assert in_force() == (expected.control, expected.watch)
    assert (in_force() == before) == (not FOLLOWS[entry.name])
    block.od.reset()
    block.power_on()
    assert in_force() == default


def test_a_tare_between_a_write_and_its_cycle_is_in_force() -> None:
    """The plans that wait for the cycle were built with the zero of before."""
    block = driving()
    block.write("Controlword", 0)
    block.od["Finger.Force"].value = 0
    for _ in range(300):
        block.tick()
    before = block.cascade.zero
    block.write("Limit.Voltage", 14_000)
    block.write(AUTO_ZERO[0], ZERO)
    zero = block.cascade.zero
    assert zero != before
    block.tick()
    assert block.cascade.zero == zero
    assert block.cascade.parameters.V_max == 140.0


@pytest.mark.parametrize(
    ("written", "then", "state"),
    [
        ([], "start_run", IdentificationState.DONE),
        ([4_330_000], "start_run", IdentificationState.IDLE),
        ([4_330_000], "tick", IdentificationState.IDLE),
        ([4_330_000, 4_339_000], "start_run", IdentificationState.DONE),
        ([4_339_000], "start_run", IdentificationState.DONE),
        # Those of the object dictionary count, which a reset has put there.
        ([4_330_000], "power_on", IdentificationState.DONE),
    ],
)
def test_a_model_that_is_written_is_not_identified(
    written: list[int], then: str, state: IdentificationState
) -> None:
    """A run may begin before the next cycle; a model that is written back is the one in force."""
    block = StimulatorBlock(stimulator_od(), PlateBlock(plate_od()))
    block.od["Model.State"].value = IdentificationState.DONE
    block.od["Model.Resonance"].value = 4_339_000
    block.start_run()
    for raw in written:
        block.write("Model.Resonance", raw)
    getattr(block, then)()
    assert block.od["Model.State"].value == state
    assert block.supervisor.plan.bound.identified == (state is IdentificationState.DONE)


@pytest.mark.parametrize("name", ["Controller.Amplitude pole", "Controller.Dead time"])
def test_parameter_of_the_design_makes_a_new_design(name: str) -> None:
    block = driving()
    block.write(name, 250)
    before = block.cascade.plan
    block.tick()
    assert block.cascade.plan.bare != before.bare


def test_limits_that_cut_nothing_keep_the_drive_to_the_bit() -> None:
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


def test_identification_is_kept_with_temperature_not_with_load() -> None:
    od = stimulator_od()
    od["Model.Load"].value = 1300
    model = PlateModel(51e-9, 0.9e-3, 43_250.0, load=1.3, temperature=29.503)
    keep_model(od, model)
    assert plate_model(od) == PlateModel(51e-9, 0.9e-3, 43_250.0, 1.3, 29.5)
    assert (od["Model.Load"].value, od["Model.Temperature"].value) == (1300, 2950)


def test_deadline_change_holds_at_once_and_ends_with_a_reset() -> None:
    """By as much as it is above 3 ms a drive may be late, of which 17 cycles more are no fault."""
    rig = driven()
    before = rig.stimulator.block.supervisor.plan
    assert write(rig, "Controlword", 0) == 0
    for index in (0x1404, 0x1405, 0x1406):
        assert write_entry(rig, rig.od.entry(index, 5), 20) == 0
    after = rig.stimulator.block.supervisor.plan
    late = [count - was for count, was in zip(after.full, before.full, strict=True)]
    assert late == [0, 0, 17 * 20, 0, 17 * 20, 17, 17 * 20, 0, 17 * 20]
    assert after._replace(full=before.full) == before
    rig.cycle(3)
    assert rig.stimulator.block.supervisor.plan == after
    rig.nmt(NMTCommand.RESET_COMMUNICATION, STIMULATOR_ID)
    assert rig.stimulator.block.supervisor.plan == before


@pytest.mark.parametrize(
    ("state", "gain", "identified"), [(2, 50_000, True), (2, 50_001, False), (1, 50_000, False)]
)
def test_model_counts_as_identified_while_unchanged(
    state: int, gain: int, identified: bool
) -> None:
    od = stimulator_od()
    present = Present(plate_model(od), UNTARED, NO_TEXTURE, 3)
    od["Model.State"].value = state
    plans = build_plans(od, present, od["Model.Gain per volt"], gain)
    assert plans.watch.bound.identified is identified


# An identification in the record of the model.


def shown(od: ObjectDictionary) -> tuple[int, int]:
    """State, and progress in %."""
    return od["Model.State"].value, od["Model.Progress"].value


def identifying() -> tuple[ObjectDictionary, ModelSheet, Cascade, Identification]:
    od, cascade = stimulator_od(), Cascade()
    identification = Identification(cascade.model, 43_390.0, cascade.parameters)
    cascade.identification = identification
    return od, ModelSheet(od), cascade, identification


def test_without_an_identification_nothing_is_shown() -> None:
    od, cascade = stimulator_od(), Cascade()
    assert not ModelSheet(od).follow(cascade)
    assert shown(od) == (0, 0)


def test_one_that_goes_on_or_fails_leaves_the_model() -> None:
    od, sheet, cascade, identification = identifying()
    before = plate_model(od)
    identification.progress = 0.379
    assert sheet.follow(cascade), "what was identified is no longer believed"
    assert not sheet.follow(cascade)
    assert shown(od) == (IdentificationState.RUNNING, 37)
    identification.fail("turned off")
    assert sheet.follow(cascade)
    assert not sheet.follow(cascade)
    assert shown(od) == (IdentificationState.FAILED, 100)
    assert plate_model(od) == before


def test_at_its_end_the_model_in_force_is_the_one_that_is_read() -> None:
    od, sheet, cascade, identification = identifying()
    found = PlateModel(51.00004e-9, 0.900004e-3, 43_250.004)
    identification.model, identification.state = found, IdentificationState.DONE
    identification.progress = 1.0
    cascade.adopt(found)
    assert sheet.follow(cascade)
    assert shown(od) == (IdentificationState.DONE, 100)
    assert cascade.model == plate_model(od) != found
    assert cascade.model.f0 == pytest.approx(43_250.0)
    assert od["Model.Quality"].value == 1223, "pi x 43.25 kHz x 0.9 ms is 122.3"


def test_written_model_is_shown_as_not_identified() -> None:
    od, sheet, _, _ = identifying()
    od["Model.State"].value = IdentificationState.DONE
    sheet.show_written(PlateModel(40e-9, 0.9e-3, 43_250.0))
    assert od["Model.State"].value == 0
    assert od["Model.Quality"].value == 1223
