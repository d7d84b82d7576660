"""The objects that show an identification and the model of the plate that came of it."""

from __future__ import annotations

from smarttac_can.control.identification import Identification
from smarttac_can.nodes.settings import keep_model
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.model import PlateModel


class ModelSheet:
    """The record *Model* of the object dictionary.

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

    def follow(
        self, identification: Identification | None, adopted: PlateModel
    ) -> PlateModel | None:
        """Show how far it is; at its end write the model adopted, and return it as it stands."""
        if identification is None:
            return None
        self._progress.value = int(100.0 * identification.progress)
        self._state.value = int(identification.state)
        return None if identification.model is None else keep_model(self._od, adopted)

    def show_quality(self, model: PlateModel) -> None:
        """Show how narrow the resonance of a model is."""
        self._quality.value = self._quality.quantise(model.quality)
