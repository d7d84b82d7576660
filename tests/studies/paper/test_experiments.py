"""Experiments of the paper refuse a finger that cannot reach its references."""

from dataclasses import replace

import pytest

from smarttac_can.studies.paper import experiments
from smarttac_can.studies.paper.experiments import Conditions


@pytest.mark.parametrize("subjects", ["presets", "fitted"])
def test_table1_refuses_finger_below_its_upper_reference(
    subjects: experiments.SubjectSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    conditions = Conditions(subjects=subjects)
    assert len(experiments.experiments(frozenset({"table1"}), conditions)) == 5
    *sound, last = experiments._FINGERS[subjects]
    slippery = last._replace(tip=replace(last.tip, mu0=0.9 * last.tip.mu0))
    monkeypatch.setitem(experiments._FINGERS, subjects, (*sound, slippery))
    with pytest.raises(
        ValueError, match=rf"^{last.tip.name}: COF 0\.\d+ is not above 1\.05 x 0\.6"
    ):
        experiments.experiments(frozenset({"table1"}), conditions)
