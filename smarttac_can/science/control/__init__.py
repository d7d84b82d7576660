"""Controllers and tribometer of the stimulator, stepped once a millisecond."""

from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.parameters import CascadeParameters

__all__ = ["Cascade", "CascadeParameters"]
