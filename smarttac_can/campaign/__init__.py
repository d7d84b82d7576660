"""Campaigns: a population of fingers run by several workers, kept, summed up and drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.campaign.runner import run_campaign
    from smarttac_can.campaign.summary import summary

__all__ = ["run_campaign", "summary"]

__getattr__ = lazily(__name__, {"run_campaign": "runner", "summary": "summary"})
