"""Failure injections: each operator does as the paper's row says, and the report tells what the workflow did."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from pcmrs.errors import CommandRefusedError
from pcmrs.journal import JournalRow
from pcmrs.planner import PlannerVerdict
from pcmrs.testing.plan import example_plan, read_plan
from pcmrs_lab.experiment import failures
from pcmrs_lab.experiment.failures import FailureResult, run_failures
from pcmrs_lab.experiment.published import FailureRun, Published, Reported
from pcmrs_lab.experiment.setup import ExperimentSetup
from tests.unit.lab.scripted_client import ScriptedClient, row, verdict

CONTROL = FailureRun(1, "none", residual_mm=2.3)
UNPLANNED = FailureRun(7, "missing_landmark_plan", rejected_at="100")
OMITTED = FailureRun(9, "missing_landmark", 2, rejected_at="110")
DISPLACED = FailureRun(15, "large_digitization_error", 1, (0.025, 0.0, 0.0), 7.6, "111")
PLAN = read_plan(example_plan("ratms"))


class Bench:
    """A daemon that refuses the command `refuses`; its journal says what the registration came to.

    Attributes:
        refuses: Name of a method of the planner, and the code of the reason.
        residual: Residual of the registration, m.
        reached: State of the registration at the end of each run.
        moves: Decision on the approach that follows a refusal.
    """

    def __init__(self, refuses: tuple[str, str] | None = None, reached: str = "111", residual: float = 0.002) -> None:
        self.refuses, self.reached, self.residual, self.moves = refuses, reached, residual, "rejected"
        self.asked: list[Any] = []
        self.rows: list[JournalRow] = []
        self.client = ScriptedClient()
        self.planner = self.scene = self

    def __getattr__(self, name: str) -> Any:
        async def ask(*given: Any, **_: Any) -> Any:
            self.asked.append((name, *given) if name in ("digitize_one", "displace_touch", "reseed") else name)
            if name == "reinitiate":
                self.rows.append(row(verdict=verdict("toolplan.reinit"), states={"registration": "000"}))
            if name == "register":
                self._registered()
            if name == "command":
                return PlannerVerdict(self.moves, "placement", "retracted", "requirement_not_met")  # type: ignore[arg-type]
            if self.refuses is not None and name == self.refuses[0]:
                self.rows.append(row(states={"registration": self.reached}))
                said = PlannerVerdict("rejected", "registration", self.reached, self.refuses[1])
                raise CommandRefusedError(f"It was rejected: {self.refuses[1]}.", verdict=said)
            return 1.0

        return ask

    def _registered(self) -> None:
        result = {"residual": self.residual, "limit": 0.004}
        given = verdict("registration.register", result=result)
        if self.refuses is not None:
            given = verdict("registration.register", "rejected", self.refuses[1])
            assert given.reason is not None
            given.reason.fields.update(result)
        self.rows.append(row(verdict=given, states={"registration": self.reached}))

    @property
    def journal(self) -> Any:
        def read(*, kind: str, branch: str | None = None) -> list[Any]:
            return [SimpleNamespace(row=each) for each in self.rows if branch is None or each.branch == branch]

        return SimpleNamespace(read=read)

    async def __aenter__(self) -> Bench:
        return self

    async def __aexit__(self, *_: object) -> None:
        pass


async def run(monkeypatch: pytest.MonkeyPatch, bench: Bench, *runs: FailureRun) -> Any:
    monkeypatch.setattr(failures, "private_bench", lambda _: bench)
    paper = Published("coil", Reported(0.5), Reported(0.2), runs)
    monkeypatch.setattr(failures, "published", lambda _: paper)
    return await run_failures([ExperimentSetup(PLAN, "ratms", 40, 1.0, "builtin", (), lambda *_: None)])


async def only(monkeypatch: pytest.MonkeyPatch, bench: Bench, given: FailureRun) -> FailureResult:
    (result,) = (await run(monkeypatch, bench, given)).runs
    assert isinstance(result, FailureResult)
    return result


async def test_a_control_completes_with_its_residual(monkeypatch: pytest.MonkeyPatch) -> None:
    result = await only(monkeypatch, Bench(), CONTROL)
    assert (result.outcome, result.rejected_at, result.reason, result.motion_refused) == ("completed", None, None, None)
    assert result.residual_mm == pytest.approx(2.0)


async def test_an_omitted_landmark_is_the_only_one_not_digitized(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(("register", "invalid_in_state"), "100")
    result = await only(monkeypatch, bench, OMITTED)
    digitized = [each[1] for each in bench.asked if each[0] == "digitize_one"]
    assert digitized == [index for index in range(len(PLAN.landmarks)) if index != 1]
    assert (result.outcome, result.rejected_at) == ("rejected", "110")


async def test_a_displaced_landmark_is_touched_beside_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(("register", "landmark_outlier"), "110", 0.0076)
    result = await only(monkeypatch, bench, DISPLACED)
    assert ("displace_touch", 0, (0.025, 0.0, 0.0)) in bench.asked
    assert (result.rejected_at, result.reason, result.motion_refused) == ("111", "landmark_outlier", True)
    assert result.residual_mm == pytest.approx(7.6)


async def test_without_a_plan_nothing_is_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(("digitize_all", "requirement_not_met"), "000")
    result = await only(monkeypatch, bench, UNPLANNED)
    assert "plan_landmarks" not in bench.asked
    assert (result.rejected_at, result.residual_mm) == ("100", None)


async def test_a_motion_after_a_refusal_is_reported_as_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(("register", "landmark_outlier"), "110")
    bench.moves = "accepted"
    assert (await only(monkeypatch, bench, DISPLACED)).motion_refused is False


async def test_injection_that_completes_is_not_as_published(monkeypatch: pytest.MonkeyPatch) -> None:
    report = await run(monkeypatch, Bench(), DISPLACED, CONTROL)
    assert [result.run for result in report.runs] == [1, 15], "in the order of the paper's table"
    summary = report.summary
    assert (summary.runs, summary.as_published, summary.controls_completed, summary.injections_rejected) == (2, 1, 1, 0)
    assert report.residual_limits_mm == {"ratms": pytest.approx(4.0)}


async def test_each_run_has_other_errors_and_starts_from_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    await run(monkeypatch, bench, CONTROL, DISPLACED)
    assert [each[1] for each in bench.asked if each[0] == "reseed"] == [41, 55]
    assert bench.asked.count("reinitiate") == 2


async def test_a_residual_of_an_earlier_run_is_not_reported_again(monkeypatch: pytest.MonkeyPatch) -> None:
    report = await run(monkeypatch, Bench(), CONTROL, UNPLANNED)
    assert [result.residual_mm is None for result in report.runs] == [False, True]
