"""The objects that show an identification and the model of the plate that came of it."""

from __future__ import annotations

from smarttac_can.control.cascade import Cascade
from smarttac_can.nodes.plans import keep_model, plate_model
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.states import IdentificationState


class ModelSheet:
    """The record *Model* of the object dictionary: the model in force is the one read there.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._od = od
        self._quality = od["Model.Quality"]
        self._state = od["Model.State"]
        self._progress = od["Model.Progress"]

    def follow(self, cascade: Cascade) -> bool:
        """Show how far an identification is, and keep its model at its end.

        Returns
        -------
        bool
            Whether the model is another one, or is believed for another reason.
        """
        identification = cascade.identification
        if identification is None:
            return False
        self._progress.value = int(100.0 * identification.progress)
        before, self._state.value = self._state.value, int(identification.state)
        if identification.model is None:
            return bool(self._state.value != before)
        keep_model(self._od, cascade.model)
        cascade.adopt(plate_model(self._od))
        self._show_quality(cascade.model)
        return True

    def show_written(self, model: PlateModel) -> None:
        """Show a model that was written: another one than before is not identified."""
        self._state.value = int(IdentificationState.IDLE)
        self._show_quality(model)

    def _show_quality(self, model: PlateModel) -> None:
        """Show how narrow the resonance is."""
        self._quality.value = self._quality.quantise(model.quality)
