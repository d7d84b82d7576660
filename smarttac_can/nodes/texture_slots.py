"""The textures that a stimulator keeps: tables in DOMAIN objects, one of which plays."""

from __future__ import annotations

from typing import Any

from smarttac_can.control.texture import NO_TEXTURE, Texture, texture_of
from smarttac_can.nodes.plans import TEXTURE
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.textures import TABLE_NAMES, TextureTable


class TextureSlots:
    """Refuses tables that cannot be played before they replace what is there.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._entries = [od[name] for name in TABLE_NAMES]
        self._slot = od[f"{TEXTURE}.Slot"]
        self._mode = od["Mode"]
        bounds = od["Setpoint.COF left"]
        self._bounds = int(bounds.low), int(bounds.high)
        self._tables: dict[Entry, TextureTable | None] = dict.fromkeys(self._entries)

    def reload(self) -> None:
        """Take what the objects hold; one that cannot be played is emptied.

        It was stored by a version with other bounds: what is written is looked at before.
        """
        for entry in self._entries:
            try:
                self._tables[entry] = self._read(entry.value)
            except ValueError:
                self._tables[entry] = None
                entry.value = entry.default

    def chosen(self, written: Entry | None = None, raw: Any = None) -> Texture:
        """Return what is in the slot that is chosen, after a write if one is given.

        `NO_TEXTURE` if it is empty.
        """
        slot = raw if written is self._slot else self._slot.value
        table = self._tables[self._entries[slot - 1]]
        return NO_TEXTURE if table is None else texture_of(table)

    def on_write(self, entry: Entry, value: Any) -> None:
        """Look at a write before it is made; what is accepted plays from the next cycle on.

        No bytes empty a slot.

        Raises
        ------
        Abort
            VALUE for what is no table that can be played, STATE for emptying the slot that is
            played, NO_DATA for playing an empty one; with the reason.
        """
        if entry in self._tables:
            self._take(entry, value)
        elif entry is self._mode and value == Mode.TEXTURE:
            self._require(self._slot.value)
        elif entry is self._slot and self._mode.value == Mode.TEXTURE:
            self._require(value)

    def _require(self, number: int) -> None:
        if self._tables[self._entries[number - 1]] is None:
            raise Abort(AbortCode.NO_DATA, f"texture slot {number} is empty")

    def _take(self, entry: Entry, data: bytes) -> None:
        try:
            table = self._read(data)
        except ValueError as error:
            raise Abort(AbortCode.VALUE, f"texture refused: {error}") from error
        chosen = entry is self._entries[self._slot.value - 1]
        if table is None and chosen and self._mode.value == Mode.TEXTURE:
            raise Abort(AbortCode.STATE, "texture is played: its slot cannot be emptied")
        self._tables[entry] = table

    def _read(self, data: bytes) -> TextureTable | None:
        if not data:
            return None
        table = TextureTable.unpack(data)
        table.require_within(*self._bounds)
        return table
