"""Placements on a machine that is too busy to show all bodies in time: the daemon is replaced by its answers."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from types import SimpleNamespace

import pytest

from pcmrs.errors import CommandRefusedError
from pcmrs.messages import PoseMessage, SceneTruth
from pcmrs.planner import Decision, MeasuredPlacement, PlannerVerdict
from pcmrs.testing.plan import example_plan, read_plan
from pcmrs.workflows.data import Registered
from pcmrs_lab.experiment import placements
from pcmrs_lab.experiment.placements import once_seen, run_placements
from pcmrs_lab.experiment.setup import ExperimentSetup

POSE = PoseMessage(position=(0.0, 0.0, 0.0), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
REGISTERED = Registered(
    id="r",
    body_ref_from_image=POSE,
    residual=0.0,
    rms=0.0,
    landmarks=(),
    digitized=(),
    patient="",
    calibration="",
)
NEEDS_POSES = ("plan_pose", "approach", "confirm", "back_off", "home")


def _refused(decision: Decision, reason: str) -> CommandRefusedError:
    verdict = PlannerVerdict(decision, "placement", "standoff", reason)
    return CommandRefusedError(f"It was {decision}: {reason}.", verdict=verdict)


class _BusyPlanner:
    """Rejects the first request of each kind that needs poses, and notes all requests."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def __getattr__(self, name: str) -> object:
        async def ask(*_: object) -> object:
            self.asked.append(name)
            if name in NEEDS_POSES and self.asked.count(name) == 1:
                raise _refused("rejected", "pose_missing")
            return MeasuredPlacement(POSE.position, (0.0, 0.0, 0.0, 1.0), 0.1, 0.2) if name == "confirm" else 1.0

        return ask


async def test_what_a_busy_tracker_rejects_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    planner = _BusyPlanner()

    async def truth() -> SceneTruth:
        return SceneTruth(tracker_from_coil=POSE, tracker_from_body_ref=POSE, body_ref_from_image=POSE)

    @asynccontextmanager
    async def bench(_: Sequence[str]) -> AsyncIterator[SimpleNamespace]:
        yield SimpleNamespace(planner=planner, client=None, scene=SimpleNamespace(truth=truth), journal=None)

    monkeypatch.setattr(placements, "private_bench", bench)
    monkeypatch.setattr(placements, "registered", lambda _: REGISTERED)
    monkeypatch.setattr(placements, "PAUSE", 0.0)
    plan = read_plan(example_plan("ratms"))
    report = await run_placements(ExperimentSetup(plan, "ratms", 1, 1.0, "builtin", (), lambda *_: None), 2)
    assert len(report.trials) == 2
    assert all(planner.asked.count(name) == 3 for name in NEEDS_POSES)


@pytest.mark.parametrize(("decision", "reason"), [("failed", "pose_missing"), ("rejected", "latched")])
async def test_begun_motion_and_other_reasons_are_not_asked_again(decision: Decision, reason: str) -> None:
    asked: list[int] = []

    async def ask() -> None:
        asked.append(1)
        raise _refused(decision, reason)

    with pytest.raises(CommandRefusedError, match=reason):
        await once_seen(ask)
    assert len(asked) == 1
