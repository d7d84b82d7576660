"""Reproduction of the paper: experiments, metrics, figures and the report."""

from smarttac_can.studies.paper.report import write_report

__all__ = ["write_report"]
