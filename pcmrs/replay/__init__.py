"""Deciding a journal anew: what the world answered comes from the record, every decision is made again."""

from pcmrs.replay.differences import Difference
from pcmrs.replay.replay import ReplayReport, replay

__all__ = ["Difference", "ReplayReport", "replay"]
