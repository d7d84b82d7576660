"""Campaigns: a population of fingers run by several workers, kept, summed up and drawn."""

from smarttac_can.campaign.runner import run_campaign
from smarttac_can.campaign.summary import summary

__all__ = ["run_campaign", "summary"]
