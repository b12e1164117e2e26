"""Replay of a journal: every decision is made again, with the answers of devices taken from the journal."""

from pcmrs.replay._differences import ReplayDifference
from pcmrs.replay.replay import ReplayReport, replay

__all__ = ["ReplayDifference", "ReplayReport", "replay"]
