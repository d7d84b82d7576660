"""Communication of a master with any CANopen device."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.canopen.master.sdo_client import SharedSdoClient

__all__ = ["SharedSdoClient"]

__getattr__ = lazily(__name__, {"SharedSdoClient": "sdo_client"})

# Errors of python-canopen repeat its log; without a handler Python would print that log, too.
logging.getLogger("canopen").addHandler(logging.NullHandler())
