"""The fingers with forces and speeds of their own, with seeds that they were not fitted with."""

import json
from statistics import fmean

import pytest
from commands import succeed

from smarttac_can.bench import Stimulator
from smarttac_can.studies.paper.experiments import Conditions, experiments
from smarttac_can.studies.paper.reproduce import fitted, reproduce, summary

SEEDS = range(1, 4)
PAPER = [(3.37, 27.6), (3.41, 44.4), (2.87, 48.0), (5.72, 30.0)]


@pytest.mark.parametrize(
    "number", [1, *(pytest.param(other, marks=pytest.mark.long) for other in (2, 3, 4))]
)
def test_rise_and_overshoot_are_those_of_the_paper(number):
    rows = []
    for seed in SEEDS:
        conditions = Conditions(seed=seed, subjects="fitted")
        identify, *subjects = experiments(frozenset({"table1"}), conditions)
        with Stimulator.simulate("local") as bench:
            identify.run(bench)
            traces = subjects[number - 1].run(bench)
        table = summary(traces, conditions, link="local", trace_sha256="")["table1"]
        (row,), (touches,) = table["subjects"], table["touches"]["subjects"]
        assert row["static_error_percent"] < 5.0
        assert touches["whole"] >= 20
        rows.append(row)
    rise, overshoot = PAPER[number - 1]
    assert fmean(row["rise_time_ms"] for row in rows) == pytest.approx(rise, abs=0.5)
    assert fmean(row["overshoot_percent"] for row in rows) == pytest.approx(overshoot, abs=5.0)


def test_results_name_fitted_chosen_and_emergent_figures(tmp_path, monkeypatch):
    monkeypatch.setattr("smarttac_can.studies.paper.experiments.PASSES", 6)
    said = succeed("reproduce", "table1", "--subjects", "fitted", "--json", tmp_path / "r.json")
    lines = said.splitlines()
    assert any(line.startswith("Rise time, subject 4") and " fitted " in line for line in lines)
    assert any(line.startswith("Static error, mean") and " emerges " in line for line in lines)
    assert "subjects fitted" in said
    results = json.loads((tmp_path / "r.json").read_text())
    assert results["subjects"] == "fitted"
    told = results["provenance"]
    assert "table1.subjects[3].rise_time_ms" in told["fitted"]
    assert "table1.mean.static_error_percent" in told["emerges"]
    assert "fig5.amplitude_only.response_time_ms" in told["chosen"]
    keys = [*told["fitted"], *told["chosen"], *told["emerges"]]
    assert len(keys) == len(set(keys))
    assert (told["free_parameters"], told["numbers_aimed_at"]) == (24, 8)


def test_each_set_of_fingers_names_its_fitted_values():
    presets, own = fitted("presets"), fitted("fitted")
    assert presets[:-1] == own[:-1]
    assert "20 numbers for 8" in presets[-1]
    assert "16 numbers for 8" in own[-1]


def test_both_links_play_the_same_fitted_fingers(monkeypatch):
    monkeypatch.setattr("smarttac_can.studies.paper.experiments.PASSES", 2)
    wanted, conditions = frozenset({"table1"}), Conditions(subjects="fitted")
    local, bus = (reproduce(wanted, conditions, link=link)[1] for link in ("local", "bus"))
    assert local["trace_sha256"] == bus["trace_sha256"]
    assert local["trace_sha256"] != reproduce(wanted, Conditions())[1]["trace_sha256"]
