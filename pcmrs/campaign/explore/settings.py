"""The configuration of an explored cell: everything as it is, at lower rates, since what passes often is what costs."""

from __future__ import annotations

from functools import cache

from pcmrs.campaign.explore.script import Physics
from pcmrs.dispatcher import Workflow
from pcmrs.settings import Settings, read_settings
from pcmrs.workflows import open_workflow
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData

DEADMAN = 1.0
"""The longest that can be configured, s: heartbeats, a quarter of it apart, cost as much as all other messages."""
SLOWER = (
    f"robot.deadman={DEADMAN}",
    "sim.arm.state_rate_hz=5",
    "sim.tracker.rate_hz=6",
    "sim.tracker.latency=0.0",
    "sim.tracker.jitter_mm=0.0",
    "sim.tracker.jitter_deg=0.0",
    "procedure.max_pose_age=0.6",
    "procedure.placement.frames=2",
    "procedure.registration.samples=2",
    "procedure.registration.reference_frames=2",
    "procedure.tracking.steady=2",
    "sim.digitization.rest_time=0.5",
    "procedure.following.longest_gap=0.2",
    "procedure.body.surface=",
)
"""Rates of streams, numbers of frames, and the ages that go with them; what is decided by them is decided alike."""

REAL_RATES = (f"robot.deadman={DEADMAN}",)
"""With MuJoCo, all streams at the rates of a real cell."""


@cache
def settings_of(workflow: str, physics: Physics, seed: int) -> Settings:
    """The whole configuration of a session."""
    rates = SLOWER if physics == "kinematic" else REAL_RATES
    own = (f"workflow={workflow}", f"sim.seed={seed}", f"sim.arm.physics={physics}")
    return read_settings(overrides=(*own, *rates))


@cache
def workflow_of(name: str) -> Workflow[Cell, PlacementData]:
    """The workflow, opened once for all sessions of this process."""
    return open_workflow(name)
