"""Values of PDOs by python-canopen and the EDS files alone: nothing of this package takes part."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import canopen

EDS = Path(__file__).parents[2] / "eds"


class EdsDecoder:
    """The TPDOs or RPDOs of a node.

    ``kind`` is ``tpdo`` or ``rpdo``.
    """

    def __init__(self, eds: str, node_id: int, kind: str) -> None:
        node = canopen.Network().add_node(node_id, str(EDS / eds))
        pdos = getattr(node, kind)
        pdos.read(from_od=True)
        self._maps: dict[int, Any] = {pdo.cob_id: pdo for pdo in pdos.values() if pdo.enabled}

    def values(self, can_id: int, data: bytes) -> dict[str, int]:
        """Raw values by name without unit; none if the frame is no PDO of the node's."""
        pdo = self._maps.get(can_id)
        if pdo is None:
            return {}
        assert len(data) == len(pdo.data)
        pdo.data[:] = data
        return {variable.name.partition(" [")[0]: int(variable.raw) for variable in pdo}
