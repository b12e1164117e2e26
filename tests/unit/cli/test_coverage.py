"""`pcmrs coverage` asks for a dry run of a refinement, and prints what it says about the points of the surface."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from click.testing import Result

from pcmrs.bus import Bus
from pcmrs.messages import DryRunRequest, DryRunResult, Reason
from tests.unit.bus.bus_cells import new_cell, open_bus
from tests.unit.cli.command_line import run
from tests.unit.client.small_daemon import Daemon

COVERAGE: dict[str, Any] = {
    "tre": 0.0014,
    "more": 20,
    "regions": [{"region": "back", "points": 0, "tre": 0.0008}, {"region": "front", "points": 31, "tre": 0.0013}],
    "advice": "20 points at the back: 1.4 → 0.8 mm",
}
OFFSETS = [{"region": "hair", "value": 0.00213, "deviation": 0.00016, "points": 64}]
REFINED = DryRunResult(result={"coverage": COVERAGE, "offsets": OFFSETS})
FEW = Reason(code="too_few_surface_points", text="12 points of the surface.", fields={"coverage": COVERAGE})
NO_LANDMARKS = Reason(code="wrong_state", text="Digitize the landmarks first.")


@asynccontextmanager
async def answering(answer: DryRunResult) -> AsyncIterator[tuple[Bus, list[DryRunRequest]]]:
    questions: list[DryRunRequest] = []

    async def checked(_: str, question: DryRunRequest) -> DryRunResult:
        questions.append(question)
        return answer

    async with open_bus(new_cell()) as bus:
        Daemon(bus)
        bus.serve("svc/check/*", DryRunRequest, checked, reading=True)
        yield bus, questions


async def coverage(on: Bus, *words: str) -> Result:
    address = ("--endpoint", on.settings.endpoint, "--site", on.settings.site, "--cell", on.settings.cell)
    return await asyncio.to_thread(run, "coverage", *words, *address)


async def test_regions_offsets_and_the_best_advice_are_printed() -> None:
    async with answering(REFINED) as (bus, questions):
        done = await coverage(bus)
    assert done.exit_code == 0, done.output
    assert [(each.branch, each.operation, each.arguments) for each in questions] == [("registration", "refine", {})]
    lines = [line.split() for line in done.output.splitlines()]
    assert ["back", "0", "0.80"] in lines
    assert ["front", "31", "1.30"] in lines
    assert "Predicted TRE 1.40 mm" in done.output
    assert "offset hair: 2.13 ± 0.16 mm, 64 points" in done.output
    assert done.output.rstrip().endswith(COVERAGE["advice"])


async def test_a_refusal_that_points_would_prevent_has_a_coverage() -> None:
    async with answering(DryRunResult(reason=FEW)) as (bus, _):
        done = await coverage(bus)
    assert done.exit_code == 0
    assert "would be refused: too_few_surface_points: 12 points of the surface." in done.output
    assert COVERAGE["advice"] in done.output


@pytest.mark.parametrize("words", [(), ("--json",)])
async def test_without_landmarks_there_is_only_the_reason(words: tuple[str, ...]) -> None:
    async with answering(DryRunResult(reason=NO_LANDMARKS)) as (bus, _):
        done = await coverage(bus, *words)
    assert done.exit_code == 1
    assert "Digitize the landmarks first." in done.output
    if words:
        assert json.loads(done.stdout)["reason"]["code"] == "wrong_state"
