"""The planning of a simulated daemon lasts as long as its window, and answers with what was known before it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.clock import Clock
from pcmrs.dispatcher import Workflow
from pcmrs.errors import RefusalError
from pcmrs.messages import Reason
from pcmrs.settings import Settings
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_sim.deterministic import planner as planning
from pcmrs_sim.deterministic.planner import Run, SimulatedPlanner

LIMIT = 0.2
"""Limit of a step's check, s."""


def refuse(_: Run) -> None:
    raise RefusalError("too_far", "It is too far.")


CHECKS = {"reachable": lambda _: None, "near": refuse}
RUN = cast(Run, SimpleNamespace(command=SimpleNamespace(branch="placement", operation="approach"), cell=None))


def ask(windows: dict[str, float], *checks: str, within: float | None = None) -> tuple[Reason | None, float]:
    """Return the answer to checks, and how long it took, s; each window is asked for by its name."""

    async def check() -> tuple[Reason | None, float]:
        clock: Clock = SimulatedClock(asyncio.get_running_loop())
        workflow = cast(Workflow[Any, Any], SimpleNamespace(registry=SimpleNamespace(checks=CHECKS)))
        settings = cast(Settings, SimpleNamespace(robot=SimpleNamespace(model="arm"), procedure=None))
        planner = SimulatedPlanner(workflow, settings, clock, windows.__getitem__)
        began = clock.monotonic()
        return await planner.check(RUN, checks, within), clock.monotonic() - began

    return run_on_simulated_loop(check())


def code_of(reason: Reason | None) -> str:
    return reason.code if reason is not None else ""


@pytest.mark.parametrize(("checks", "code"), [(["reachable"], ""), (["reachable", "near"], "too_far")])
def test_a_window_of_no_length_asks_the_checks_at_once(checks: Sequence[str], code: str) -> None:
    reason, took = ask({"plan:placement.approach": 0.0}, *checks)
    assert (code_of(reason), took) == (code, 0.0)


def test_a_check_of_a_step_has_its_own_window() -> None:
    windows = {"plan:placement.approach": 9.0, "plan:placement.approach:reachable": 0.0}
    reason, took = ask(windows, "reachable", within=LIMIT)
    assert (reason, took) == (None, 0.0)


def test_a_window_beyond_the_limit_of_a_step_is_too_late() -> None:
    reason, took = ask({"plan:placement.approach:reachable": LIMIT + 0.01}, "reachable", within=LIMIT)
    assert code_of(reason) == "planner_late"
    assert took == pytest.approx(LIMIT)


def test_planning_in_a_window_knows_only_what_was_before(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []

    def note(what: str, given: Any = None) -> Any:
        seen.append(f"{what} at {asyncio.get_running_loop().time():.1f} s")
        return given

    monkeypatch.setattr(planning, "find_arm", lambda _: None)
    monkeypatch.setattr(planning, "ArmModel", lambda _: None)
    made = SimpleNamespace(answer=lambda request: note("planned", f"answer to {request}"))
    monkeypatch.setattr(planning, "PlanningCell", lambda *_: made)
    monkeypatch.setattr(planning, "request_of", lambda run, checks: note("copied", "the copy"))
    monkeypatch.setattr(
        planning, "apply_answer", lambda run, request, answer: note("applied", Reason(code=answer, text=request))
    )
    run = cast(Run, SimpleNamespace(command=RUN.command, cell=SimpleNamespace(surface=None, mounting=None)))
    monkeypatch.setattr(f"{__name__}.RUN", run)
    reason, took = ask({"plan:placement.approach": 0.3}, "reachable")
    assert reason == Reason(code="answer to the copy", text="the copy")
    assert seen == ["copied at 0.0 s", "planned at 0.0 s", "applied at 0.3 s"]
    assert took == pytest.approx(0.3)
