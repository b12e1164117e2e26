"""A touch is measured only if pointer and body are seen and the tip is held still."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.messages import Snapshot
from tests.unit.workflows.workflow_bench import LANDMARKS, WorkflowBench, open_bench

COUNT = len(LANDMARKS)


async def _plan(bench: WorkflowBench) -> None:
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)


@pytest.mark.parametrize("body", ["pointer", "body_ref"])
async def test_unseen_body_is_not_digitized(bench: WorkflowBench, body: str) -> None:
    await _plan(bench)
    await bench.scene.occlude(body, True)
    verdict = await bench.refuse("digitization.digitize_all", "pose_missing", decision="failed")
    assert verdict.reason is not None
    assert "occluded" in verdict.reason.text
    assert bench.states["digitization"] == "0"
    assert bench.data.digitized == (None,) * COUNT
    await bench.scene.occlude(body, False)
    await bench.accept("digitization.digitize_all")


async def test_a_pointer_that_shakes_is_refused() -> None:
    shaky = {"tracker": {"jitter_mm": 2.0}}
    async with open_bench(sim=shaky) as bench:
        await _plan(bench)
        verdict = await bench.refuse("digitization.digitize_one", "spread_too_large", decision="failed", index=0)
        assert verdict.reason is not None
        assert verdict.reason.fields["spread"] > verdict.reason.fields["limit"]
        assert bench.data.digitized == (None,) * COUNT


async def test_a_landmark_that_nobody_touches_is_refused_in_time(
    bench: WorkflowBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    released: list[bool] = []
    release = bench.cell.pointer.release

    async def never(*_: object) -> None:
        await asyncio.Event().wait()

    async def counted() -> None:
        released.append(True)
        await release()

    await _plan(bench)
    monkeypatch.setattr(bench.cell.pointer, "touch", never)
    monkeypatch.setattr(bench.cell.pointer, "release", counted)
    before, limit = bench.clock.monotonic(), bench.cell.settings.registration.touch_timeout_s
    verdict = await bench.refuse("digitization.digitize_one", "not_touched", decision="failed", index=0)
    assert verdict.reason is not None
    assert verdict.reason.fields["limit"] == limit
    assert bench.clock.monotonic() - before == pytest.approx(limit, abs=0.1)
    assert released, "the pointer asks nobody any more"


async def test_landmark_and_number_are_shown_until_it_is_touched(bench: WorkflowBench) -> None:
    await _plan(bench)
    beeps: list[int] = []
    bench.cell.beep = beeps.append
    await bench.accept("digitization.digitize_all")
    prompts = [
        each.prompt
        for message in bench.published
        if isinstance(message, Snapshot)
        for each in message.running
        if each.prompt is not None
    ]
    shown = list(dict.fromkeys((prompt.number, prompt.landmark, prompt.count) for prompt in prompts))
    assert shown == [(number + 1, landmark["name"], COUNT) for number, landmark in enumerate(LANDMARKS)]
    assert f"landmark 1 of {COUNT}, {LANDMARKS[0]['name']}" in prompts[0].text
    assert bench.dispatcher.snapshot().running == []
    assert beeps == [3, 2] * COUNT
