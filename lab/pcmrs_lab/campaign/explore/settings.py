"""Configuration of an explored cell: as delivered, but at lower rates, since frequent messages dominate the cost."""

from __future__ import annotations

from functools import cache

import msgspec

from pcmrs.dispatcher import Workflow
from pcmrs.settings import Settings, read_settings
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.opening import open_workflow
from pcmrs_lab.campaign.explore.script import Physics

DEADMAN = 1.0
"""Longest configurable deadman, s: heartbeats, a quarter of it apart, cost as much as all other messages."""
SLOWER = (
    f"robot.deadman={DEADMAN}",
    "sim.tracker.rate_hz=6.25",
    "sim.arm.state_rate_hz=3.125",
    "sim.tracker.latency=0.0",
    "sim.tracker.jitter_mm=0.0",
    "procedure.max_pose_age=0.6",
    "procedure.placement.frames=2",
    "procedure.registration.samples=2",
    "procedure.registration.reference_frames=2",
    "procedure.tracking.steady=2",
    "sim.digitization.rest_time=0.5",
    "procedure.following.longest_gap=0.2",
    "procedure.following.period=0.016",
    "procedure.alignment.off_time=0.5",
    "procedure.stimulation.pose_age=0.2",
    "procedure.stimulation.speed_time=0.5",
    "procedure.body.surface=",
)
"""Rates of streams, numbers of frames, and the ages that go with them; decisions are unchanged by them.

The tracker is as slow as a pulse permits, which needs 4 frames within 0.5 s; the joints come with every second frame.
"""

REAL_RATES = (f"robot.deadman={DEADMAN}",)
"""Settings with MuJoCo: all streams at the rates of a real cell."""


WATCHED_SCENE = (
    "scene_events.sources.camera={silent_after=1.0, rate_hz=50.0}",
    'scene_events.rules=[{label="hand"}]',
)
"""Source and rule of a watched scene. Its frames are slow, too; see `FRAME_RATE`."""
FRAME_RATE = 4.0
"""Rate of the detector, Hz."""


def settings_of(workflow: str, physics: Physics, seed: int, *, scene: bool = False) -> Settings:
    """Return the whole configuration of a session.

    Args:
        workflow: Name of the workflow.
        physics: Physics of the simulated arm.
        seed: Seed of the simulation.
        scene: True if a detector watches the scene.
    """
    common = _common(workflow, physics, scene)
    return msgspec.structs.replace(common, sim=common.sim | {"seed": seed})


@cache
def _common(workflow: str, physics: Physics, scene: bool) -> Settings:
    """Return the common configuration of all sessions; it is cached, since reading and checking it is slow."""
    rates = SLOWER if physics == "kinematic" else REAL_RATES
    watched = WATCHED_SCENE if scene else ()
    return read_settings(overrides=(f"workflow={workflow}", f"sim.arm.physics={physics}", *rates, *watched))


@cache
def workflow_of(name: str) -> Workflow[Cell, PlacementData]:
    """Return the workflow, opened once for all sessions of this process."""
    return open_workflow(name)
