"""Analogue-input block of CiA 404: the measured channels under the indices of the profile."""

from __future__ import annotations

from typing import Final

from smarttac_can.od.dictionary import ObjectDictionary

CHANNELS: Final = ("force x", "force y", "normal force", "COF", "amplitude", "temperature")
"""Channels 1 to 6."""
_NOT_VALID, _POSITIVE_OVERLOAD = 1, 2
_LATERAL_GAUGES, _NORMAL_GAUGES, _PICK_UP = 0b0000011, 0b0111100, 0b1000000
_COF: Final = CHANNELS.index("COF")
_SENSORS: Final = (
    _LATERAL_GAUGES,
    _LATERAL_GAUGES,
    _NORMAL_GAUGES,
    _LATERAL_GAUGES | _NORMAL_GAUGES,
    _PICK_UP,
    0,
)


class AnalogueInput:
    """Process values and their status.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        sources = (
            "Contact.Force x",
            "Contact.Force y",
            "Contact.Normal force",
            "Contact.COF",
            "Vibration.Amplitude",
            "Plate temperature",
        )
        # The counts of the sources are those that the unit and the digits of a channel announce.
        for channel, source in zip(CHANNELS, sources, strict=True):
            od[f"AI input PV.AI input PV {channel}"].compute(od[source].read)
        self._status = [od[f"AI status.AI status {channel}"] for channel in CHANNELS]
        self.reset()

    def reset(self) -> None:
        """Forget the last cycle."""
        self._shown: tuple[bool, int] | None = None

    def update(self, touching: bool, saturation: int) -> None:
        """Show whether the values of a cycle are valid.

        Parameters
        ----------
        touching
            Whether there is a finger; without, the COF is not valid.
        saturation
            Sensors at the end of their range, as in `smarttac_can.vocabulary.signals.Measurement`.
        """
        if (touching, saturation) == self._shown:
            return
        self._shown = touching, saturation
        for entry, sensors in zip(self._status, _SENSORS, strict=True):
            entry.value = _NOT_VALID | _POSITIVE_OVERLOAD if saturation & sensors else 0
        if not touching:
            self._status[_COF].value |= _NOT_VALID
