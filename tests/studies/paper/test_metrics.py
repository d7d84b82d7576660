import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_traces import (
    NAMES,
    PASS_MS,
    all_experiments,
    amplitude_sweep,
    friction,
    trace,
    vibration,
)

from smarttac_can.bench.traces import Trace, read_csv, sha256, write_csv
from smarttac_can.science.population import steps
from smarttac_can.science.population.steps import Step, UndefinedError
from smarttac_can.studies.paper import metrics
from smarttac_can.studies.paper import references as paper
from smarttac_can.studies.paper.experiments import Conditions
from smarttac_can.studies.paper.reproduce import summary

RUN = Conditions(seed=3, dead_time=250.0)


def test_no_overshoot_is_stated_where_a_sample_is_missing():
    with pytest.raises(UndefinedError, match="a sample is missing"):
        metrics.overshoot_above(np.array([0.9, np.nan, 1.2]), 1.0, 1.0)
    assert metrics.overshoot_above(np.array([0.9, 1.2]), 1.0, 1.0) == pytest.approx(20.0)


def still(experiment):
    """A run that was never switched on."""
    return trace(experiment, 0, W=np.zeros(60), V=np.zeros(60))


def summary_of(traces):
    return summary(traces, RUN, link="local", trace_sha256="ab")


def step(curve, before=0.2, after=0.3):
    """A step sampled from -20 to 80 ms from a function of time."""
    t = np.arange(-20.0, 81.0)
    return Step(t, np.array([curve(x) for x in t]), before, after)


def ramp(start, length, low=0.2, high=0.3):
    return lambda t: low + (high - low) * min(1.0, max(0.0, (t - start) / length))


def replaced(old, **columns):
    counts = old.counts.copy()
    for name, values in columns.items():
        counts[:, NAMES.index(name)] = values
    return Trace(old.experiment, old.subject, counts)


def rows_without(old, *gone):
    return Trace(old.experiment, old.subject, np.delete(old.counts, gone, axis=0))


class TestResponseTime:
    def test_interpolates_the_entry_from_below(self):
        W = np.array([0.0, 0.5, 0.9, 1.0, 1.0])
        assert metrics.response_time(W, 1.0) == pytest.approx(2.5)

    def test_interpolates_the_entry_from_above(self):
        W = np.array([0.0, 1.0, 1.25, 1.0, 1.0])
        assert metrics.response_time(W, 1.0) == pytest.approx(2.8)

    def test_counts_the_last_entry(self):
        W = np.array([0.0, 1.0, 1.0, 1.0, 0.9, 1.0])
        assert metrics.response_time(W, 1.0) == pytest.approx(4.5)

    @settings(max_examples=50)
    @given(st.floats(0.3, 5.0), st.floats(0.1, 3.0), st.floats(0.01, 0.2))
    def test_of_an_exponential_is_that_of_the_formula(self, time_constant, reference, band):
        W = reference * (1 - np.exp(-np.arange(80.0) / time_constant))
        exact = -time_constant * math.log(band)
        # The chord lies below a concave curve: never early, and by less than a tick late.
        assert exact - 1e-9 <= metrics.response_time(W, reference, band) <= exact + 1

    def test_is_nought_where_W_never_leaves(self):
        assert metrics.response_time(np.ones(5), 1.0) == 0.0

    @pytest.mark.parametrize("W", [[0.0, 1.0, 0.9], [0.0, 1.0, math.nan], []])
    def test_does_not_exist_outside_the_band(self, W):
        with pytest.raises(UndefinedError, match="does not stay within 5 % of 1"):
            metrics.response_time(np.array(W), 1.0)

    def test_does_not_exist_with_a_hole_at_the_entry(self):
        with pytest.raises(UndefinedError, match="a sample is missing"):
            metrics.response_time(np.array([0.0, math.nan, 1.0, 1.0]), 1.0)


class TestStep:
    def test_rise_time_of_a_ramp(self):
        assert steps.rise_time(step(ramp(1.3, 5.0))) == pytest.approx(4.0, abs=0.1)
        assert steps.rise_time(step(ramp(1.0, 5.0))) == pytest.approx(4.0)

    def test_a_fall_counts_like_a_rise(self):
        fall = step(lambda t: 0.5 - ramp(1.0, 5.0)(t), before=0.3, after=0.2)
        assert steps.rise_time(fall) == pytest.approx(4.0)

    def test_levels_are_those_of_the_curve_not_the_references(self):
        shifted = step(ramp(1.0, 5.0, low=0.21, high=0.29))
        assert steps.rise_time(shifted) == pytest.approx(4.0)
        assert steps.static_error_percent(shifted) == pytest.approx(5.0)

    def test_overshoot_in_percent_of_the_step(self):
        peak = step(lambda t: 0.2 if t <= 0 else 0.3 + 0.03 * (t == 5))
        assert steps.overshoot_percent(peak) == pytest.approx(30.0)
        trough = step(lambda t: 0.3 if t <= 0 else 0.2 - 0.04 * (t == 5), before=0.3, after=0.2)
        assert steps.overshoot_percent(trough) == pytest.approx(40.0)

    @pytest.mark.parametrize("at", [1, 2, 3, 79, 80])
    def test_overshoot_is_seen_from_first_to_last_millisecond(self, at):
        peak = step(lambda t: 0.2 if t <= 0 else 0.3 + 0.03 * (t == at))
        # One sample of the 41 from 40 ms on lifts the level by a fraction of itself.
        level = 0.03 / 41 * (at >= 40)
        expected = 100 * (0.03 - level) / (0.1 + level)
        assert steps.overshoot_percent(peak) == pytest.approx(expected, rel=1e-9)

    def test_the_level_after_the_switch_is_that_from_40_ms_on(self):
        before = step(lambda t: 0.2 if t <= 0 else 0.5 if t < 40 else 0.3)
        assert before.levels() == pytest.approx((0.2, 0.3))
        first = step(lambda t: 0.2 if t <= 0 else 0.341 if t == 40 else 0.3)
        assert first.levels() == pytest.approx((0.2, 0.301))

    def test_the_level_before_the_switch_is_that_up_to_its_tick(self):
        last = step(lambda t: 0.221 if t == 0 else 0.2 if t < 0 else 0.3)
        assert last.levels() == pytest.approx((0.201, 0.3))

    def test_metrics_ignore_the_curve_before_the_switch(self):
        early = step(lambda t: 0.35 if t == -10 else ramp(1.0, 5.0)(t))
        assert steps.overshoot_percent(early) == pytest.approx(0, abs=1e-9)
        # The spike lifts the level before the switch by 0.15 / 21.
        assert steps.rise_time(early) == pytest.approx(0.8 * (0.1 - 0.15 / 21) / 0.02)

    def test_second_order_against_the_formulas(self):
        zeta, wn = 0.3, 0.3
        wd = wn * math.sqrt(1 - zeta**2)

        def answer(t):
            if t < 0:
                return 0.2
            ring = math.cos(wd * t) + zeta * wn / wd * math.sin(wd * t)
            return 0.2 + 0.1 * (1 - math.exp(-zeta * wn * t) * ring)

        exact = 100 * math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
        assert steps.overshoot_percent(step(answer)) == pytest.approx(exact, abs=1)
        # Rise time of zeta 0.3 is 1.321 / wn (Franklin, Powell, Emami-Naeini: about 1.3).
        assert steps.rise_time(step(answer)) == pytest.approx(1.321 / wn, abs=0.15)

    def test_curve_that_does_not_follow_has_a_static_error_only(self):
        flat = step(lambda t: 0.2 + 0.01 * (t > 0))
        for metric in (steps.rise_time, steps.overshoot_percent):
            with pytest.raises(UndefinedError, match="moves by 10 % of the step"):
                metric(flat)
        assert steps.static_error_percent(flat) == pytest.approx(100 * 0.09 / 0.3)

    def test_nan_has_no_metrics(self):
        hole = step(lambda t: math.nan if t == 50 else ramp(1.0, 5.0)(t))
        with pytest.raises(UndefinedError, match="nan %"):
            steps.rise_time(hole)


class TestAlignment:
    def test_cuts_each_direction(self):
        run = friction(1, 0.2, 0.3, passes=6)
        ups, downs = (metrics.align_at_switch([run], up=up) for up in (True, False))
        assert [len(t.steps) for t in (ups, downs)] == [3, 2]
        assert {(s.before, s.after) for s in ups.steps} == {(0.2, 0.3)}
        assert {(s.before, s.after) for s in downs.steps} == {(0.3, 0.2)}
        first = ups.steps[0]
        assert (first.time_ms[0], first.time_ms[-1]) == (-20, 80)
        begin = PASS_MS - 20
        assert np.array_equal(first.mu, run.cof[begin : begin + 101])

    def test_time_nought_is_the_first_tick_of_the_new_reference(self):
        run = trace(
            "table1",
            1,
            mu=np.r_[np.full(50, 2000), np.full(100, 3000)],
            mu_ref=np.r_[np.full(50, 2000), np.full(100, 3000)],
        )
        (only,) = metrics.align_at_switch([run], up=True).steps
        assert only.mu[only.time_ms == -1] == pytest.approx(0.2)
        assert only.mu[only.time_ms == 0] == pytest.approx(0.3)

    def test_several_runs_count_together(self):
        runs = [friction(1, 0.2, 0.3, passes=6, seed=s) for s in (1, 2)]
        assert len(metrics.align_at_switch(runs, up=True).steps) == 6

    def test_incomplete_touches_are_dropped_and_counted(self):
        run = friction(1, 0.2, 0.3, passes=8)
        assert metrics.align_at_switch([run], up=True).dropped == 0
        lifted = run.counts[:, 1].copy()
        lifted[PASS_MS + 80] = 0
        touches = metrics.align_at_switch([replaced(run, mu=lifted)], up=True)
        assert (len(touches.steps), touches.dropped) == (3, 1)
        lost = metrics.align_at_switch([rows_without(run, PASS_MS - 20)], up=True)
        assert (len(lost.steps), lost.dropped) == (3, 1)
        twice = run.counts[:, 2].copy()
        twice[PASS_MS + 40 : PASS_MS + 45] = 2000
        again = metrics.align_at_switch([replaced(run, mu_ref=twice)], up=True)
        assert (len(again.steps), again.dropped) == (3, 2)
        short = metrics.align_at_switch(
            [rows_without(run, *range(3 * PASS_MS + 80, 8 * PASS_MS))], up=True
        )
        assert (len(short.steps), short.dropped) == (1, 1)

    def test_begin_and_end_of_control_are_not_steps(self):
        run = friction(1, 0.2, 0.3, passes=3)
        off = run.counts[:, 2].copy()
        off[:200] = 0
        off[-200:] = 0
        touches = [
            metrics.align_at_switch([replaced(run, mu_ref=off)], up=up) for up in (True, False)
        ]
        assert [len(t.steps) + t.dropped for t in touches] == [1, 1]

    def test_mean_curve_averages_noise_away(self):
        noisy = friction(1, 0.2, 0.3, passes=41, noise=0.011)
        clean = friction(1, 0.2, 0.3, passes=41)
        mean, exact = (metrics.align_at_switch([r], up=True).mean_curve() for r in (noisy, clean))
        assert np.std(mean.mu - exact.mu) == pytest.approx(0.011 / math.sqrt(20), rel=0.3)

    def test_no_mean_of_nothing_and_of_different_steps(self):
        with pytest.raises(UndefinedError, match=r"no whole touch \(0 dropped\)"):
            metrics.align_at_switch([], up=True).mean_curve()
        runs = [friction(1, 0.2, 0.3), friction(2, 0.3, 0.4)]
        with pytest.raises(UndefinedError, match="different references"):
            metrics.align_at_switch(runs, up=True).mean_curve()


class TestFinalValues:
    def test_mean_over_the_last_20_ms(self):
        f = np.full(60, 4_325_000)
        f[-20:] = 4_339_000
        f[-1] = 4_341_000
        run = trace("x", 0, f=f)
        assert metrics.final_mean(run, run.frequency_hz) == pytest.approx(43_391.0)

    def test_needs_20_ticks_in_a_row(self):
        for run in (
            trace("x", 0, f=np.zeros(19)),
            rows_without(trace("x", 0, f=np.zeros(60)), 50),
        ):
            with pytest.raises(UndefinedError, match="no 20 ticks in a row"):
                metrics.final_mean(run, run.frequency_hz)

    def test_voltage_difference_is_on_top_of_the_lower_voltage(self):
        runs = [trace("x", 0, V=np.full(30, v)) for v in (2600, 2000)]
        assert metrics.voltage_difference_percent(*runs) == pytest.approx(30.0)
        with pytest.raises(UndefinedError, match="ends without a voltage"):
            metrics.voltage_difference_percent(runs[0], trace("y", 0, V=np.zeros(30)))

    def test_time_counts_from_the_first_voltage(self):
        for delay in (0, 5, 12):
            run = vibration("amplitude_only", 1.5, 20.0, 43_390.0, delay=delay)
            W = metrics.from_switch_on(run, run.amplitude_um)
            assert metrics.response_time(W, 1.0) == pytest.approx(1.5 * math.log(20), abs=0.1)

    def test_no_switch_on(self):
        off = trace("x", 0, W=np.zeros(30))
        with pytest.raises(UndefinedError, match="x has no voltage"):
            metrics.from_switch_on(off, off.amplitude_um)
        gap = rows_without(vibration("amplitude_only", 1.5, 20.0, 43_390.0), 20)
        with pytest.raises(UndefinedError, match="lost ticks"):
            metrics.from_switch_on(gap, gap.amplitude_um)


class TestFrictionRatio:
    def test_is_that_of_the_map(self):
        runs = amplitude_sweep(1, 0.4, 1.2)
        exact = 100 * (0.25 + 0.75 * math.exp(-((1.5 / 1.2) ** 1.5)))
        assert metrics.friction_ratio_percent(runs, 1, 1.5) == pytest.approx(exact, abs=0.1)
        assert metrics.friction_ratio_percent(runs, 1, 0.0) == 100.0

    def test_amplitude_that_was_not_reached_is_no_result(self):
        *runs, last = amplitude_sweep(1, 0.4, 1.2)
        runs.append(replaced(last, W=np.full(len(last), 17_000)))
        with pytest.raises(UndefinedError, match=r"fig2\.2\.0 ran at 1\.700 um"):
            metrics.friction_ratio_percent(runs, 1, 2.0)

    def test_no_contact_is_no_result(self):
        first, *runs = amplitude_sweep(1, 0.4, 1.2)
        runs.append(replaced(first, mu=np.zeros(len(first), dtype=int)))
        with pytest.raises(UndefinedError, match="no contact"):
            metrics.friction_ratio_percent(runs, 1, 2.0)


class TestSummary:
    def test_from_the_file_alone(self, tmp_path):
        runs = all_experiments()
        write_csv(tmp_path / "traces.csv", runs)
        again = read_csv(tmp_path / "traces.csv")
        digest = sha256(tmp_path / "traces.csv")
        both = [summary(t, RUN, link="local", trace_sha256=digest) for t in (runs, again)]
        assert both[0] == both[1]
        assert json.loads(json.dumps(both[0], allow_nan=False)) == both[0]

    def test_complete_runs_have_every_value(self):
        result = summary_of(all_experiments())
        assert result["unavailable"] == {}
        assert (result["seed"], result["law"], result["link"]) == (3, "measured", "local")
        assert (result["dead_time_us"], result["trace_sha256"]) == (pytest.approx(250), "ab")
        assert result["fig2"]["amplitudes_um"] == [0.0, 0.5, 1.0, 1.5, 2.0]
        assert [row["subject"] for row in result["fig2"]["subjects"]] == [1, 2, 3, 4, 5]
        column = [row["ratio_percent"][3] for row in result["fig2"]["subjects"]]
        assert result["fig2"]["mean_ratio_percent"][3] == pytest.approx(np.mean(column))
        loops = result["fig5"]["amplitude_and_frequency"]
        assert loops["final_frequency_hz"] == pytest.approx(43_390)
        assert loops["steady_amplitude_um"] == pytest.approx(1)
        assert result["fig6"]["amplitude_only"]["voltage_v"] == pytest.approx(26)
        assert result["fig6"]["voltage_difference_percent"] == pytest.approx(30)

    def test_table_1_is_the_up_step_of_the_mean_curve(self):
        runs = all_experiments()
        table = summary_of(runs)["table1"]
        for up, block in ((True, table), (False, table["down"])):
            for i, row in enumerate(block["subjects"]):
                own = [run for run in runs if (run.experiment, run.subject) == ("table1", i + 1)]
                touches = metrics.align_at_switch(own, up=up)
                single = block["touches"]["subjects"][i]
                assert single["whole"] == len(touches.steps) == single["count"]["rise_time_ms"]
                for name, metric in steps.STEP_METRICS.items():
                    assert row[name] == metric(touches.mean_curve())
                    each = [metric(one) for one in touches.steps]
                    assert single[name] == pytest.approx(np.mean(each))
                    assert single["std"][name] == pytest.approx(np.std(each, ddof=1))
            for name in steps.STEP_METRICS:
                column = [row[name] for row in block["subjects"]]
                assert block["mean"][name] == pytest.approx(np.mean(column))
                assert block["std"][name] == pytest.approx(np.std(column, ddof=1))

    def test_noise_biases_single_touches_not_the_mean_curve(self):
        table = summary_of(all_experiments(noise=0.011))["table1"]
        clean = summary_of(all_experiments(noise=0.0))["table1"]
        exact = clean["mean"]["overshoot_percent"]
        assert table["mean"]["overshoot_percent"] == pytest.approx(exact, abs=4)
        assert table["touches"]["mean"]["overshoot_percent"] > exact + 5

    def test_experiment_not_run_is_none_without_a_failure(self):
        result = summary_of([])
        assert result["fig5"]["amplitude_only"]["response_time_ms"] is None
        assert result["table1"]["mean"]["rise_time_ms"] is None
        assert result["unavailable"] == {}

    def test_missing_figure_is_none_with_a_reason(self):
        result = summary_of([still("fig5.amplitude_only")])
        assert result["fig5"]["amplitude_only"]["response_time_ms"] is None
        reasons = result["unavailable"]
        key = "fig5.amplitude_only.response_time_ms"
        assert reasons[key] == "fig5.amplitude_only has no voltage"

    def test_no_mean_over_an_incomplete_column(self):
        runs = [run for run in all_experiments() if run.subject != 3 or run.experiment != "table1"]
        still = trace("table1", 3, mu=np.full(900, 4500), mu_ref=np.repeat([4000, 5000, 4000], 300))
        result = summary_of([*runs, still])
        table, reasons = result["table1"], result["unavailable"]
        assert table["subjects"][2]["rise_time_ms"] is None
        assert table["subjects"][2]["static_error_percent"] == pytest.approx(12.5)
        assert table["mean"]["rise_time_ms"] is None
        assert "0 % of the step" in reasons["table1.subjects[2].rise_time_ms"]
        assert reasons["table1.mean.rise_time_ms"] == "3 of 4 values"
        assert reasons["table1.down.std.overshoot_percent"] == "3 of 4 values"
        assert reasons["table1.touches.subjects[2].rise_time_ms"] == "0 of 1 values"


def test_the_published_spread_is_the_sample_one():
    for values, (mean, std) in (
        (paper.RISE_TIMES_MS, paper.RISE_TIME_MS),
        (paper.OVERSHOOTS_PERCENT, paper.OVERSHOOT_PERCENT),
    ):
        assert np.mean(values) == pytest.approx(mean, abs=0.005)
        assert np.std(values, ddof=1) == pytest.approx(std, rel=0.01)
