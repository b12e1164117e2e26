"""Planner and viewer of a PCMRS cell for a program with one thread and a timer.

No Slicer, no Qt and no third-party package is needed; Python 3.9 or newer.
"""

from __future__ import annotations

from . import panel
from .feed import CellState, Feed
from .link import BusyError, Link, LinkError
from .messages import MessageError, Verdict, explain
from .planner import ACTIONS, Planner
from .poses import Pose, PoseError, pose_of_line, pose_of_matrix
from .signer import Signer, read_key

__all__ = [
    "ACTIONS",
    "BusyError",
    "CellState",
    "Feed",
    "Link",
    "LinkError",
    "MessageError",
    "Planner",
    "Pose",
    "PoseError",
    "Signer",
    "Verdict",
    "explain",
    "panel",
    "pose_of_line",
    "pose_of_matrix",
    "read_key",
]
