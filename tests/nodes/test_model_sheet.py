"""What the record of the model shows of an identification."""

import pytest

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.control.cascade import Cascade
from smarttac_can.control.identification import Identification
from smarttac_can.nodes.parameters import ModelSheet, plate_model
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.states import IdentificationState

RUNNING, DONE, FAILED = 1, 2, 3


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
    assert shown(od) == (RUNNING, 37)
    identification.fail("turned off")
    assert sheet.follow(cascade)
    assert not sheet.follow(cascade)
    assert shown(od) == (FAILED, 100)
    assert plate_model(od) == before


def test_at_its_end_the_model_in_force_is_the_one_that_is_read() -> None:
    od, sheet, cascade, identification = identifying()
    found = PlateModel(51.00004e-9, 0.900004e-3, 43_250.004)
    identification.model, identification.state = found, IdentificationState.DONE
    identification.progress = 1.0
    cascade.adopt(found)
    assert sheet.follow(cascade)
    assert shown(od) == (DONE, 100)
    assert cascade.model == plate_model(od) != found
    assert cascade.model.f0 == pytest.approx(43_250.0)
    assert od["Model.Quality"].value == 1223, "pi x 43.25 kHz x 0.9 ms is 122.3"


def test_another_model_that_is_written_is_shown_as_not_identified() -> None:
    od, sheet, _, _ = identifying()
    od["Model.State"].value = DONE
    sheet.show_written(PlateModel(40e-9, 0.9e-3, 43_250.0))
    assert od["Model.State"].value == 0
    assert od["Model.Quality"].value == 1223
