"""The following experiment: how it brings a tool to its place on a busy machine, and what it reports of each run."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.errors import CommandRefusedError
from pcmrs.testing.plan import example_plan, read_plan
from pcmrs_lab.experiment import following
from pcmrs_lab.experiment.error_series import ErrorSeries, PlacementErrorMonitor
from pcmrs_lab.experiment.following import ATTEMPTS, OCCLUDED, run_following
from pcmrs_lab.experiment.setup import ExperimentSetup
from tests.unit.lab.experiment.scene_at_rest import REGISTERED, SceneAtRest
from tests.unit.lab.scripted_client import ScriptedClient, failed, rejected

RUN = ErrorSeries([0.0, 1.0, 2.0, 3.0], [0.1, 2.0, 3.0, 0.2], [True, True, False, True], [1.0, 1.0, 3.0], lag=0.4)


class Monitor:
    """Sees the tool aligned as told, and every run as `RUN`."""

    def __init__(self, client: ScriptedClient, aligned: list[bool], series: ErrorSeries) -> None:
        self.client, self._aligned, self._series = client, aligned, series
        self.watched: list[tuple[float, bool]] = []
        self.snapshot = SimpleNamespace(latched=True)

    async def aligned(self, _timeout: float) -> bool:
        return self._aligned.pop(0) if self._aligned else True

    async def watch(self, duration: float, *, even_if_lost: bool = False) -> ErrorSeries:
        self.watched.append((duration, even_if_lost))
        return self._series

    def state(self, branch: str) -> str:
        return self.client.branches[branch]


class Experiment:
    """Daemons of the experiment, each with this client; settings with which they were started, and their planner."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, aligned: list[bool], series: ErrorSeries = RUN) -> None:
        self.client = ScriptedClient(placement="placed")
        self.client.leads = {
            "placement.locate": {"placement": "retracted"},
            "placement.approach": {"placement": "standoff"},
            "placement.confirm": {"placement": "placed"},
            "placement.back_off": {"placement": "standoff"},
            "placement.stop_following": {"placement": "placed"},
            "placement.follow": {"placement": "following"},
        }
        self.monitor = Monitor(self.client, aligned, series)
        self.scene = SceneAtRest()
        self.started: list[list[str]] = []
        monkeypatch.setattr(following, "private_bench", self.bench)
        monkeypatch.setattr(following, "registered", lambda _: REGISTERED)
        monkeypatch.setattr(following, "PAUSE", 0.0)
        monkeypatch.setattr(following, "PlacementErrorMonitor", lambda *_: cast(PlacementErrorMonitor, self.monitor))

    def bench(self, settings: list[str]) -> Any:
        self.started.append(settings)
        return self

    async def __aenter__(self) -> Any:
        async def accept(*_: object) -> None:
            pass

        names = ("connect", "plan_landmarks", "digitize_all", "register", "plan_pose")
        planner = SimpleNamespace(**dict.fromkeys(names, accept))
        return SimpleNamespace(planner=planner, client=self.client, scene=self.scene)

    async def __aexit__(self, *_: object) -> None:
        pass

    async def run(self) -> Any:
        plan = read_plan(example_plan("ratms"))
        setup = ExperimentSetup(plan, "ratms", 7, 1.0, "builtin", ("procedure.patient=x",), lambda *_: None)
        return await run_following(setup, 20.0)


async def test_every_motion_is_followed_with_and_without_compensation(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = Experiment(monkeypatch, aligned=[])
    report, drawn = await experiment.run()
    names = ["still", "breathing", "steps", "bursts", "drift"]
    assert [(run.scenario, run.compensated) for run in report.runs] == [
        (name, compensated) for compensated in (False, True) for name in names
    ]
    assert [each.result for each in drawn] == report.runs
    wanted = ["compensated=false", "compensated=true", "compensated=true"]
    assert [settings[-1].rpartition(".")[2] for settings in experiment.started] == wanted
    assert all("sim.seed=7" in settings and "procedure.patient=x" in settings for settings in experiment.started)


async def test_a_run_reports_its_errors_and_whether_it_was_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    (run, *_), _ = (lambda result: (result[0].runs, result))(await Experiment(monkeypatch, aligned=[]).run())
    assert run.true_mm.rms == pytest.approx(math.sqrt((0.01 + 4.0 + 9.0 + 0.04) / 4))
    assert (run.true_mm.max, run.measured_mm.max) == (3.0, 3.0)
    assert (run.allowed, run.true_allowed_mm, run.lag, run.lost) == (0.75, 2.0, 0.4, False)


async def test_the_tool_is_brought_back_from_wherever_it_was_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the tracker had not seen it yet when the robot was connected: a busy machine shows it late."""
    experiment = Experiment(monkeypatch, aligned=[])
    experiment.client.branches["placement"] = "unknown"
    await experiment.run()
    assert experiment.client.asked[:4] == [f"placement.{name}" for name in ("locate", "approach", "confirm", "follow")]


async def test_a_held_tool_is_acknowledged_and_follows_again(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = Experiment(monkeypatch, aligned=[False])
    experiment.client.branches["placement"], experiment.client.latched = "held", True
    experiment.client.answers["placement.follow"] = [("accepted", None)]
    await experiment.run()
    first = [f"placement.{name}" for name in ("back_off", "confirm", "follow", "stop_following", "follow")]
    asked = [name for name in experiment.client.asked if name != "robot.acknowledge"]
    assert asked[:5] == first
    assert experiment.client.asked[0] == "robot.acknowledge"


async def test_a_tool_that_is_never_aligned_names_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = Experiment(monkeypatch, aligned=[False] * ATTEMPTS)
    with pytest.raises(CommandRefusedError, match="the machine is too slow or too busy"):
        await experiment.run()
    assert experiment.client.asked.count("placement.follow") == ATTEMPTS


async def test_only_a_rejection_for_a_late_tracker_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = Experiment(monkeypatch, aligned=[])
    experiment.client.answers["placement.follow"] = [rejected("pose_stale"), failed("pose_stale", "It was late.")]
    with pytest.raises(CommandRefusedError, match=r"placement\.follow was failed in placed: It was late\."):
        await experiment.run()
    assert experiment.client.asked == ["placement.follow"] * 2


async def test_a_run_without_any_frame_has_no_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tool was lost before the tracker's first frame."""
    lost = ErrorSeries([0.0], [0.5], [False], [])
    report, _ = await Experiment(monkeypatch, aligned=[], series=lost).run()
    run = report.runs[0]
    assert (run.true_mm.max, run.allowed, run.true_allowed_mm) == (0.5, 0.0, 0.0)
    assert all(math.isnan(value) for value in (run.measured_mm.rms, run.measured_mm.p99, run.measured_mm.max))


async def test_hidden_reference_is_watched_although_the_tool_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = Experiment(monkeypatch, aligned=[])
    report, _ = await experiment.run()
    assert experiment.monitor.watched[-2:] == [(1.0, False), (OCCLUDED, True)]
    assert experiment.scene.hidden == [("body_ref", True)]
    assert (report.occlusion.latched, report.occlusion.state, report.occlusion.moved_mm) == (True, "following", 0.0)
