"""A calibration finds the parameters of the weighings, and reports residuals."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from smarttac_can.bench import (
    BenchError,
    Calibration,
    Placing,
    State,
    Stimulator,
    Weighing,
    mean_gauges,
    read_plan,
    weigh,
    write_calibration,
)
from smarttac_can.bench.simulation import LinkName

CROSSTALK = np.array([[0.97, 0.05], [-0.04, 1.03]])
NODES_MM = np.array([-27.5, 28.5, -27.5, 28.5])
LEVEL = Placing(0, 0, 0, 0)
SO_FAR = (-28.0, 28.0, -28.0, 28.0)
G = 9.81
TILTS = [(200, 30, 0), (200, 30, 90), (200, 30, 180), (200, 30, 270), (100, 20, 45)]
LEVEL_ROWS = [(300, 0, 0, -20), (300, 0, 0, 20), (150, 0, 0, 0)]
PLAN = [Placing(m, a, z, 0.0) for m, a, z in TILTS] + [Placing(*row) for row in LEVEL_ROWS]


def weighing(placing: Placing, noise: np.random.Generator | None = None) -> Weighing:
    """Readings of gauges with this cross-talk at these nodes, with nulls of 0.5 N and so on."""
    fx, fy, fn = placing.load(G)
    left, right = np.linalg.solve([[1.0, 1.0], [NODES_MM[0], NODES_MM[1]]], [fn, fn * placing.x_mm])
    added = np.array([*(CROSSTALK @ (fx, fy)), left / 2, right / 2, left / 2, right / 2])
    empty = np.array([0.5, -0.7, 0.1, 0.2, 0.3, -0.4])
    if noise is not None:
        empty = empty + noise.normal(0.0, 4.3e-3 / 8.0, 6)
        added = added + noise.normal(0.0, 4.3e-3 / 8.0, 6)
    return Weighing(placing, empty, empty + added)


def fitted(plan: list[Placing], noise: np.random.Generator | None = None) -> Calibration:
    return Calibration.fit([weighing(placing, noise) for placing in plan], SO_FAR, G)


def test_the_load_of_a_weight_on_a_tilted_plate() -> None:
    assert Placing(1000 / 9.81, 30, 0, 0).load(9.81) == pytest.approx((0.5, 0.0, 0.75**0.5))
    assert Placing(1000 / 9.81, 30, 90, 0).load(9.81) == pytest.approx((0.0, 0.5, 0.75**0.5))


def test_exact_weighings_give_the_calibration_exactly() -> None:
    calibration = fitted(PLAN)
    assert calibration.lateral == pytest.approx(np.linalg.inv(CROSSTALK).ravel())
    assert calibration.positions_mm == pytest.approx(NODES_MM)
    assert calibration.scale == pytest.approx(1.0)
    assert calibration.rms == pytest.approx((0.0, 0.0, 0.0, 0.0), abs=1e-9)
    assert calibration.shortcomings() == []


def test_the_uncertainty_is_how_far_noise_moves_the_fit() -> None:
    """Of 200 calibrations with the noise of 64 samples: within 15 % of their spread."""
    rng = np.random.default_rng(1)
    many = [fitted(PLAN, rng) for _ in range(200)]
    spread = np.std([one.lateral for one in many], axis=0)
    told = np.sqrt(np.mean([np.square(one.lateral_uncertainty) for one in many], axis=0))
    assert told == pytest.approx(spread, rel=0.15)
    assert max(abs(np.mean([one.lateral for one in many], axis=0) - many[0].lateral)) < 5e-3
    assert all(one.shortcomings() == [] for one in many)


def test_calibration_keeps_values_without_weighings() -> None:
    level = fitted(PLAN[5:])
    assert set(level.objects()) == {f"Calibration.Position of S{gauge}" for gauge in range(3, 7)}
    assert np.isnan(level.rms[:2]).all()
    tilted = fitted(PLAN[:5])
    assert len(tilted.objects()) == 4
    assert tilted.positions_mm is None


def test_one_position_moves_all_gauges_as_little_as_explains_it() -> None:
    """A weight at 0: the sum of the positions is known, not each of them."""
    positions = fitted([Placing(300, 0, 0, 0.0)]).positions_mm
    assert positions is not None
    left, right = (28.5, 27.5)  # shares of the weight on the left pair and the right one
    assert left * (positions[0] + positions[2]) + right * (positions[1] + positions[3]) == (
        pytest.approx(0.0, abs=1e-9)
    )


@pytest.mark.parametrize(
    ("gauge", "factor", "complaint"),
    [
        (0, 0.5, None),  # a gain of S1 is corrected
        (2, -1.0, "S3 to S6 show"),
        (3, 0.9, "S3 to S6 show 0.97"),
    ],
)
def test_a_gauge_of_another_gain(gauge: int, factor: float, complaint: str | None) -> None:
    turned = []
    for placing in PLAN:
        one = weighing(placing)
        loaded = one.loaded.copy()
        loaded[gauge] = one.empty[gauge] + factor * one.gauges[gauge]
        turned.append(one._replace(loaded=loaded))
    said = Calibration.fit(turned, SO_FAR, G).shortcomings()
    assert any(line.startswith(complaint) for line in said) if complaint else said == []


def test_residuals_of_as_many_weighings_as_unknowns_are_unknown() -> None:
    rng = np.random.default_rng(1)
    few = fitted([*PLAN[:2], *PLAN[5:7]], rng)
    assert np.isnan(few.residuals[:2, :2]).all()
    assert np.isnan(few.rms[3])
    assert [line.partition(" is ")[0].partition(" are ")[0] for line in few.unchecked()] == [
        "the lateral matrix",
        "the positions",
    ]
    one_more = fitted([*PLAN[:3], *PLAN[5:8]], rng)
    assert one_more.unchecked() == []
    assert all(rms > 1e-5 for rms in one_more.rms)


def test_a_wrong_weight_is_left_over() -> None:
    weighings = [weighing(placing) for placing in PLAN]
    heavier = weighing(PLAN[0]._replace(mass_g=250.0))
    weighings[0] = heavier._replace(placing=PLAN[0])
    assert Calibration.fit(weighings, SO_FAR, G).shortcomings()[0].startswith("Fx is left with")
    assert Calibration.fit(weighings, SO_FAR, G).shortcomings()[-1].startswith("S3 to S6 show")
    beside = weighing(PLAN[5]._replace(x_mm=-10.0))
    weighings[5] = beside._replace(placing=PLAN[5])
    assert "x is left with" in " ".join(Calibration.fit(weighings, SO_FAR, G).shortcomings())


def test_tilts_in_one_direction_are_refused() -> None:
    for plan in (PLAN[:1], [PLAN[0], PLAN[2]]):
        with pytest.raises(ValueError, match="load one direction only: tilt along x and along y"):
            fitted(plan)
    with pytest.raises(ValueError, match="no weighing"):
        fitted([])


def test_side_gauges_that_read_the_same_are_refused() -> None:
    alike = [weighing(placing) for placing in PLAN]
    for one in alike:
        one.loaded[1], one.empty[1] = one.loaded[0], one.empty[0]
    with pytest.raises(ValueError, match="S1 and S2 do not distinguish the tilted weighings"):
        Calibration.fit(alike, SO_FAR, G)


@pytest.fixture
def bench() -> Iterator[Stimulator]:
    with Stimulator.simulate("local") as made:
        made.run(0.2)
        yield made


def test_a_calibration_is_written_with_nulls_and_window(bench: Stimulator) -> None:
    nulls = mean_gauges(bench)
    written = write_calibration(bench, fitted(PLAN), nulls)
    assert len(written) == 19
    assert bench.get("Calibration.Fx from S2") == pytest.approx(fitted(PLAN).lateral[1], abs=5e-5)
    assert bench.get("Calibration.Position of S4", "mm") == pytest.approx(28.5, abs=5e-3)
    assert bench.get("Gauge null.Null of S3", "N") == pytest.approx(nulls[2], abs=5e-5)
    assert bench.get("Gauge null.Window") == 60
    bench.tare()
    with pytest.raises(BenchError, match="not tared: S6 reads"):
        bench.set("Fault.Sensor", 6)
        bench.set("Fault.Value", 80)
        bench.set("Fault.Kind", 3)
        bench.tare()


@pytest.mark.parametrize("link", ["local", "bus"])
def test_a_calibration_is_rehearsed_on_a_simulated_plate(link: LinkName) -> None:
    plan = [Placing(200, 30, azimuth, 0) for azimuth in (0, 90, 180, 270)]
    plan += [Placing(300, 0, 0, x) for x in (-20, 20)]
    with Stimulator.simulate(link) as bench:
        bench.run(0.2)
        done: list[str] = []

        def do(placing: Placing) -> None:
            done.append(str(placing))
            bench.finger.put(placing)

        weighings = [weigh(bench, placing, do) for placing in plan]
        do(LEVEL)
        nulls = mean_gauges(bench)
        calibration = Calibration.fit(weighings, SO_FAR)
        assert calibration.shortcomings() == []
        write_calibration(bench, calibration, nulls)
        bench.tare()
        assert bench.state is State.READY
        bench.finger.put(Placing(50, 0, 0, 10))
        with pytest.raises(BenchError, match=r"not tared: S[46] reads"):
            bench.tare()
        bench.run(0.1)
        assert bench.get("Contact.Normal force", "N") == pytest.approx(0.49, abs=0.02)
        assert bench.get("Contact.Position", "mm") == pytest.approx(10, abs=0.5)
    # The simulated cross-talk is ((1, 0.04), (-0.03, 1.02)); its gauges stand at +-28 mm.
    inverse = np.linalg.inv([[1.0, 0.04], [-0.03, 1.02]]).ravel()
    assert calibration.lateral == pytest.approx(inverse, abs=5e-3)
    assert calibration.positions_mm == pytest.approx(SO_FAR, abs=0.2)
    assert done[:4] == [
        "tilt the plate by 30 degrees towards 0, nothing on it",
        "put 200 g at 0 mm",
        "tilt the plate by 30 degrees towards 90, nothing on it",
        "put 200 g at 0 mm",
    ]
    assert done[-2:] == ["put 300 g at 20 mm", "level the plate, nothing on it"]


def test_a_weight_in_the_wrong_place_is_found_in_a_rehearsal(bench: Stimulator) -> None:
    plan = [Placing(300, 0, 0, -20), Placing(300, 0, 0, 20), Placing(300, 0, 0, 0)]
    weighings = [
        weigh(bench, placing, lambda p: bench.finger.put(p._replace(x_mm=min(p.x_mm, 10.0))))
        for placing in plan
    ]
    (said,) = Calibration.fit(weighings, SO_FAR).shortcomings()
    assert said.startswith("x is left with ")


def test_a_weight_that_is_no_placing(bench: Stimulator) -> None:
    with pytest.raises(ValueError, match=r"placing \(200, 30\) is no Placing"):
        bench.finger.put((200, 30))  # type: ignore[arg-type]


def test_a_null_below_the_step_of_its_object_is_none(bench: Stimulator) -> None:
    nulls = np.array([4e-5, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert write_calibration(bench, fitted(PLAN), nulls)["Gauge null.Null of S1"] == 0.0


def test_refused_calibration_writes_no_object(bench: Stimulator) -> None:
    names = fitted(PLAN).objects()
    before = {name: bench.get(name) for name in names}
    far = fitted(PLAN)._replace(positions_mm=(-27.0, 28.0, -27.0, 99.0))
    with pytest.raises(BenchError, match="Position of S6"):
        write_calibration(bench, far, np.zeros(6))
    assert {name: bench.get(name) for name in names} == before


HEAD = "mass_g,angle_deg,azimuth_deg,x_mm\n"


def test_a_plan_is_read(tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    path.write_text(HEAD + "200,30,0,0\n300, 0, 0, -20.5\n")
    assert read_plan(path) == [Placing(200, 30, 0, 0), Placing(300, 0, 0, -20.5)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: the header is not mass_g,angle_deg,azimuth_deg,x_mm"),
        ("mass,angle\n", "line 1: the header is not"),
        (HEAD, "no weighing"),
        (HEAD + "200,30,0\n", "line 2: 3 fields are not the 4 of the header"),
        (HEAD + "1,0,0,0\nten,0,0,0\n", "line 3: mass_g 'ten' is not a number"),
        (HEAD + "801,0,0,0\n", "line 2: mass_g 801 is outside 1..800"),
        (HEAD + "nan,0,0,0\n", "mass_g nan is outside"),
        (HEAD + "200,61,0,0\n", "angle_deg 61 is outside 0..60"),
        (HEAD + "200,0,0,39\n", "x_mm 39 is outside -38..38"),
        (HEAD + "1,0,0,0\n" * 101, "line 102: there are more than 100 rows"),
        (HEAD + '"' + ("a" * 150 + "\n") * 1000, "line 2: 0 fields are not the 4 of the header"),
    ],
)
def test_calibration_plan_refuses_malformed_rows(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_plan(path)
