"""Controllers and tribometer of the stimulator, stepped once a millisecond."""

from smarttac_can.control.cascade import Cascade
from smarttac_can.control.parameters import CascadeParameters

__all__ = ["Cascade", "CascadeParameters"]
