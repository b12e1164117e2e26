"""When the tool counts as aligned: two thresholds, each for its time, and nothing in between changes it."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.spatial import Transform
from pcmrs.workflows._alignment import AlignmentGate, AlignmentWatch
from pcmrs.workflows.settings import AlignmentSettings, ProcedureSettings
from tests.unit.workflows.workflow_bench import WorkflowBench

LIMITS = AlignmentSettings()
PERIOD = 0.02
Error = tuple[float, float] | None
WITHIN: Error = (0.9, 1.9)
BETWEEN: Error = (1.2, 2.5)
FAR: Error = (1.6, 0.0)
TURNED: Error = (0.0, 3.1)
errors = st.none() | st.tuples(st.floats(0.0, 3.0), st.floats(0.0, 6.0))
courses = st.lists(st.tuples(errors, st.integers(1, 40)), max_size=12)


def run(gate: AlignmentGate, stretches: list[tuple[Error, int]]) -> tuple[list[Error], list[bool]]:
    """Errors and answers at every look, each error for a number of looks."""
    seen = [error for error, looks in stretches for _ in range(looks)]
    return seen, [gate.update(number * PERIOD, error) for number, error in enumerate(seen)]


def within(error: Error) -> bool:
    return error is not None and error[0] <= LIMITS.on_mm and error[1] <= LIMITS.on_deg


def beyond(error: Error) -> bool:
    return error is None or error[0] > LIMITS.off_mm or error[1] > LIMITS.off_deg


@given(courses)
def test_it_opens_and_closes_only_after_its_time_and_then_always(stretches: list[tuple[Error, int]]) -> None:
    seen, answers = run(AlignmentGate(LIMITS), stretches)
    on, off = round(LIMITS.on_time / PERIOD), round(LIMITS.off_time / PERIOD)
    before = False
    for number, answer in enumerate(answers):
        # One look more or less, since times are sums of floats.
        settled = all(map(within, seen[max(0, number - on + 1) : number + 1])) and number >= on - 1
        surely_within = number > on and all(map(within, seen[number - on - 1 : number + 1]))
        lost = all(map(beyond, seen[max(0, number - off + 1) : number + 1])) and number >= off - 1
        surely_lost = number > off and all(map(beyond, seen[number - off - 1 : number + 1]))
        if answer and not before:
            assert settled
        if before and not answer:
            assert lost
        assert answer or not surely_within
        assert not answer or not surely_lost
        before = answer


@given(st.lists(st.tuples(st.floats(1.0, 1.5), st.floats(2.0, 3.0)), max_size=100), st.booleans())
def test_between_the_thresholds_it_stays_as_it_is(between: list[tuple[float, float]], opened: bool) -> None:
    gate = AlignmentGate(LIMITS)
    _, before = run(gate, [(WITHIN, 60)] if opened else [(None, 60)])
    assert before[-1] == opened
    outside = [error for error in between if not within(error)]
    assert all(gate.update(2.0 + number * PERIOD, error) == opened for number, error in enumerate(outside))


@pytest.mark.parametrize("lost", [FAR, TURNED, None])
def test_each_of_distance_angle_and_sight_closes_it(lost: Error) -> None:
    _, answers = run(AlignmentGate(LIMITS), [(WITHIN, 30), (lost, 8), (BETWEEN, 50), (WITHIN, 30)])
    assert answers[29]
    assert answers[31], "not at once"
    assert not answers[37]
    assert not answers[87], "not by an error between the thresholds"
    assert answers[117]


def test_a_moment_beyond_does_not_close_it() -> None:
    _, answers = run(AlignmentGate(LIMITS), [(WITHIN, 30), (FAR, 4), (WITHIN, 1), (FAR, 4), (BETWEEN, 30)])
    assert all(answers[26:])


@pytest.mark.parametrize("decided", [True, False], ids=["refused", "waiting"])
async def test_opened_gate_closes_at_once_and_only_repeats_wait(decided: bool) -> None:
    now = 0.0
    posted: list[tuple[float, str]] = []

    def post(_branch: str, operation: str) -> asyncio.Future[None]:
        posted.append((now, operation))
        answer = asyncio.get_running_loop().create_future()
        if decided:
            answer.set_result(None)
        return answer

    act: Any = SimpleNamespace(
        cell=SimpleNamespace(settings=ProcedureSettings()),
        clock=SimpleNamespace(monotonic=lambda: now),
        states={"alignment": "0"},
        post=post,
        show=lambda **_: None,
    )
    watch = AlignmentWatch(act)

    def look(error_mm: float) -> None:
        frame: Any = {"coil": SimpleNamespace(captured=now)}
        watch.take(frame, Transform(np.eye(3), np.array((error_mm / 1000.0, 0.0, 0.0))))
        watch.evaluate()

    for number in range(33):
        now = number / 64
        look(0.1)
    assert posted == [(0.5, "within")]
    act.states["alignment"] = "1"
    for number in range(33, 60):
        now = number / 64
        look(5.0)
    # At the first frame after 0.1 s; refused, it is asked again after a quarter of a second; not while it still waits.
    repeated = [(56 / 64, "outside")] if decided else []
    assert posted[1:] == [(40 / 64, "outside"), *repeated]


async def test_tool_without_registration_stays_watched_and_outside(
    unrevoked: WorkflowBench,
) -> None:
    """A blueprint that leaves the tool at its place then: nothing is aligned with a pose that nobody knows."""
    await unrevoked.to_placed()
    await unrevoked.until(lambda: unrevoked.states["alignment"] == "1")
    await unrevoked.accept("registration.clear_registration")
    await unrevoked.until(lambda: unrevoked.states["alignment"] == "0")
    await unrevoked.clock.sleep(2.0)
    assert (unrevoked.states["placement"], unrevoked.states["alignment"]) == ("placed", "0")
    assert not unrevoked.dispatcher.snapshot().latched, "to watch has not failed"
    await unrevoked.accept("registration.register")
    await unrevoked.until(lambda: unrevoked.states["alignment"] == "1")
