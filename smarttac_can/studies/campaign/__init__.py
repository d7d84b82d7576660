"""Campaigns: run a population of fingers on several workers; store, summarise and plot it."""

from smarttac_can.studies.campaign.runner import run_campaign
from smarttac_can.studies.campaign.summary import summary

__all__ = ["run_campaign", "summary"]
