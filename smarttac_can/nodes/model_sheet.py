"""The objects that show an identification and the model of the plate that came of it."""

from __future__ import annotations

from smarttac_can.control.cascade import Cascade
from smarttac_can.nodes.settings import keep_model, plate_model
from smarttac_can.od.dictionary import ObjectDictionary
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
        """Show how far an identification is; keep its model at its end, and tell of that."""
        identification = cascade.identification
        if identification is None:
            return False
        self._progress.value = int(100.0 * identification.progress)
        self._state.value = int(identification.state)
        if identification.model is None:
            return False
        keep_model(self._od, cascade.model)
        self._put_in_force(cascade)
        return True

    def take_written(self, cascade: Cascade) -> None:
        """Put a model in force that was written: another one than before is not identified."""
        if plate_model(self._od) != cascade.model:
            self._state.value = int(IdentificationState.IDLE)
            self._put_in_force(cascade)

    def _put_in_force(self, cascade: Cascade) -> None:
        """Let the cascade adopt the model, and show how narrow its resonance is."""
        cascade.adopt(plate_model(self._od))
        self._quality.value = self._quality.quantise(cascade.model.quality)
