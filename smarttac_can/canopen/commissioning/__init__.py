"""Commissioning of devices: scan of the bus, node-IDs, DCF, DBC, comparison with an EDS."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.canopen.commissioning.dbc import make_dbc
    from smarttac_can.canopen.commissioning.dcf import make_dcf
    from smarttac_can.canopen.commissioning.node_ids import assign_node_id, unconfigured

__all__ = ["assign_node_id", "make_dbc", "make_dcf", "unconfigured"]

__getattr__ = lazily(
    __name__,
    {
        "make_dbc": "dbc",
        "make_dcf": "dcf",
        "assign_node_id": "node_ids",
        "unconfigured": "node_ids",
    },
)
