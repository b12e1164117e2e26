"""Placements on a machine that is too busy to show all bodies in time: the daemon is replaced by its answers."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest

from pcmrs.errors import CommandRefusedError, ConfigurationError
from pcmrs.planner import Decision, MeasuredPlacement, PlannerVerdict
from pcmrs.testing.plan import example_plan, read_plan
from pcmrs.workflows.toolplan import ToolPose
from pcmrs_lab.experiment import placements
from pcmrs_lab.experiment.placements import Trial, once_seen, registered, run_placements, summary_of
from pcmrs_lab.experiment.private import ExperimentBench
from pcmrs_lab.experiment.published import PUBLISHED
from pcmrs_lab.experiment.setup import ExperimentSetup
from tests.unit.lab.experiment.scene_at_rest import POSE, REGISTERED, SceneAtRest
from tests.unit.lab.scripted_client import row

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


class _LateTracker:
    """Does not show at first that the tool, which has backed off, is clear of the body."""

    def __init__(self) -> None:
        self.states = iter(["held"])

    async def state(self) -> object:
        return SimpleNamespace(branches={"placement": next(self.states, "standoff")})


class Planned:
    """A journal with two plans, whose predicted errors are 3 and 2.5 mm."""

    def read(self, *, kind: str, branch: str) -> list[SimpleNamespace]:
        assert (kind, branch) == ("outcome", "toolplan")
        return [SimpleNamespace(row=row(result={"tre": tre})) for tre in (0.003, 0.0025)]


class _Unlucky(_BusyPlanner):
    """Never gets the tool within tolerance at one of the poses."""

    def __getattr__(self, name: str) -> object:
        ask = super().__getattr__(name)

        async def unlucky(*arguments: object) -> object:
            if name == "confirm" and self.asked.count("confirm") == 1:
                self.asked.append(name)
                raise _refused("failed", "not_converged")
            return await ask(*arguments)  # type: ignore[operator]

        return unlucky


async def test_a_placement_that_misses_counts_and_the_next_follows(monkeypatch: pytest.MonkeyPatch) -> None:
    @asynccontextmanager
    async def bench(_: Sequence[str]) -> AsyncIterator[SimpleNamespace]:
        yield SimpleNamespace(planner=_Unlucky(), client=_LateTracker(), scene=SceneAtRest(), journal=Planned())

    monkeypatch.setattr(placements, "private_bench", bench)
    monkeypatch.setattr(placements, "registered", lambda _: REGISTERED)
    monkeypatch.setattr(placements, "PAUSE", 0.0)
    plan = read_plan(example_plan("ratms"))
    report = await run_placements(ExperimentSetup(plan, "ratms", 1, 1.0, "builtin", (), lambda *_: None), 3)
    assert [failed.reason for failed in report.failed] == ["not_converged"]
    assert (report.summary.trials, report.summary.failed) == (2, 1)
    assert report.summary.success_rate == pytest.approx(2 / 3)
    assert report.summary.predicted_error_mm is not None
    assert report.summary.predicted_error_mm.max == pytest.approx(2.5)


async def test_what_a_busy_tracker_rejects_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    planner = _BusyPlanner()

    @asynccontextmanager
    async def bench(_: Sequence[str]) -> AsyncIterator[SimpleNamespace]:
        yield SimpleNamespace(planner=planner, client=_LateTracker(), scene=SceneAtRest(), journal=Planned())

    monkeypatch.setattr(placements, "private_bench", bench)
    monkeypatch.setattr(placements, "registered", lambda _: REGISTERED)
    monkeypatch.setattr(placements, "PAUSE", 0.0)
    plan = read_plan(example_plan("ratms"))
    report = await run_placements(ExperimentSetup(plan, "ratms", 1, 1.0, "builtin", (), lambda *_: None), 2)
    assert len(report.trials) == 2
    assert [planner.asked.count(name) for name in NEEDS_POSES] == [3, 3, 3, 4, 3], "one more back_off: it was held"


@pytest.mark.parametrize(("decision", "reason"), [("failed", "pose_missing"), ("rejected", "latched")])
async def test_begun_motion_and_other_reasons_are_not_asked_again(decision: Decision, reason: str) -> None:
    asked: list[int] = []

    async def ask() -> None:
        asked.append(1)
        raise _refused(decision, reason)

    with pytest.raises(CommandRefusedError, match=reason):
        await once_seen(ask)
    assert len(asked) == 1


@pytest.mark.parametrize(("trials", "poses"), [(1, None), (2, ())])
async def test_too_few_trials_or_poses_refused_before_daemon_starts(
    monkeypatch: pytest.MonkeyPatch, trials: int, poses: tuple[ToolPose, ...] | None
) -> None:
    monkeypatch.setattr(placements, "private_bench", None)
    plan = read_plan(example_plan("ratms"))
    plan = plan if poses is None else msgspec.structs.replace(plan, poses=poses)
    with pytest.raises(ConfigurationError, match="at least 2 trials and 1 pose"):
        await run_placements(ExperimentSetup(plan, "ratms", 1, 1.0, "builtin", (), lambda *_: None), trials)


@pytest.mark.parametrize("reason", ["pose_missing", "pose_stale", "planner_late", "planner_lost"])
async def test_what_stays_late_is_asked_again_and_reported_at_last(
    monkeypatch: pytest.MonkeyPatch, reason: str
) -> None:
    monkeypatch.setattr(placements, "PAUSE", 0.0)
    asked: list[int] = []

    async def ask() -> None:
        asked.append(1)
        raise _refused("rejected", reason)

    with pytest.raises(CommandRefusedError, match=reason):
        await once_seen(ask)
    assert len(asked) == placements.PATIENCE + 1


def test_registration_in_force_is_the_last_one_of_the_journal() -> None:
    given = [msgspec.structs.replace(REGISTERED, id=name) for name in ("old", "new")]
    results: list[dict[str, Any] | None] = [{"registered": msgspec.to_builtins(each)} for each in given]
    rows = [row(result=result) for result in (*results, {"registered": None}, {"other": 1}, None)]
    journal = SimpleNamespace(read=lambda **_: [SimpleNamespace(row=each) for each in rows])
    assert registered(cast(ExperimentBench, SimpleNamespace(journal=journal))) == given[1]


def test_summary_is_over_all_trials_beside_the_papers_values() -> None:
    trials = [Trial(number, number, 0.1, 2.0 * number, 0.2, 3.0, 0.5, POSE, POSE) for number in (1, 2, 3)]
    summary = summary_of("femoroplasty", trials)
    assert (summary.trials, summary.translation_error_mm.mean, summary.true_translation_error_mm.max) == (3, 2.0, 6.0)
    assert summary.published_translation_error_mm == PUBLISHED["femoroplasty"].translation_error_mm
