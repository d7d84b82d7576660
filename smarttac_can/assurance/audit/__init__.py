"""Independent check of results: the rows of the fault matrix against its log."""

from smarttac_can.assurance.audit.fault_rows import DifferenceError, verify_rows

__all__ = ["DifferenceError", "verify_rows"]
