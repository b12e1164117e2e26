"""Points of a grid in order: a failed one stops the next, and what the coil's pose is checked against."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import RefusalError
from pcmrs.fsm import Effect, examine
from pcmrs.journal import Journal
from pcmrs.messages import BlueprintTag, Verdict
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.testing.clock import ManualClock
from pcmrs.workflows import find_workflow
from pcmrs.workflows.data import as_message
from pcmrs.workflows.grid_mapping import Data, plan_is_of_point, point_reachable, point_within_tolerance, settle
from pcmrs.workflows.toolplan import ToolPose, pose_of
from tests import ROOT
from tests.support.shipped import shipped_workflow
from tests.unit.workflows.workflow_bench import LANDMARKS, POSES, WorkflowBench, open_bench

GRID = POSES[:3]
PAGE = (ROOT / "docs" / "workflows.md").read_text()


@asynccontextmanager
async def mapping(procedure: Mapping[str, Any] | None = None) -> AsyncIterator[WorkflowBench]:
    """A registered head and a planned grid."""
    async with open_bench(procedure, workflow="grid_mapping") as bench:
        await bench.register()
        await bench.accept("mapping.plan_grid", poses=GRID)
        yield bench


async def _go_to_next(bench: WorkflowBench) -> None:
    await bench.accept("toolplan.aim")
    if bench.states["placement"] == "replanned" and (await bench.do("placement.approach")).decision == "accepted":
        await bench.accept("placement.confirm")
        return
    if bench.states["placement"] != "retracted":
        await bench.accept("placement.home")
    await bench.accept("placement.approach")
    await bench.accept("placement.confirm")


async def _perform(bench: WorkflowBench) -> Verdict:
    await _go_to_next(bench)
    return await bench.accept("mapping.perform")


async def test_points_in_order_with_a_failed_repeated_and_skipped_one() -> None:
    async with mapping() as bench:
        await bench.refuse("mapping.perform", "not_at_point")
        first = await _perform(bench)
        assert _at(bench) == "point_2"
        assert first.result is not None
        assert first.result["point"] == "point_1"
        assert first.result["translation_error"] < 0.001
        assert (first.result["performed"], first.result["skipped"]) == (["point_1"], [])
        await bench.refuse("mapping.perform", "other_point_planned")
        await _go_to_next(bench)
        assert bench.data.plan == as_message(pose_of(ToolPose(**GRID[1])))
        await bench.scene.occlude("coil", True)
        await bench.refuse("mapping.perform", "pose_missing", decision="failed")
        assert _at(bench) == "point_2_stopped"
        await bench.scene.occlude("coil", False)
        await bench.refuse("mapping.perform", "invalid_in_state")
        await bench.refuse("toolplan.aim", "no_next_point")
        assert await _after(bench, "mapping.repeat") == "point_2"
        assert await _after(bench, "mapping.perform") == "point_3"
        ended = await bench.accept("mapping.skip")
        assert ended.state == "done"
        assert ended.result == {
            "point": "point_3",
            "performed": ["point_1", "point_2"],
            "skipped": ["point_3"],
            "points": 3,
        }
        await bench.refuse("mapping.abandon", "invalid_in_state")


async def test_a_point_at_which_the_coil_is_not_stops_the_next() -> None:
    async with mapping({"limits": {"point_tolerance_mm": 1e-6}}) as bench:
        await _go_to_next(bench)
        missed = await bench.refuse("mapping.perform", "point_missed", decision="failed")
        assert _at(bench) == "point_1_stopped"
        assert missed.result is not None
        assert missed.result["translation_error"] > 1e-9
        assert await _after(bench, "mapping.skip") == "point_2"
        assert (await bench.accept("mapping.abandon")).state == "abandoned"
        await bench.refuse("toolplan.aim", "no_next_point")


@pytest.mark.nightly
async def test_nudged_coil_is_measured_against_the_point() -> None:
    """The nudged pose does not count."""
    async with mapping() as bench:
        await _go_to_next(bench)
        await bench.accept("placement.nudge", translation=[0.0, 0.003, 0.0])
        missed = await bench.refuse("mapping.perform", "point_missed", decision="failed")
        assert missed.result is not None
        assert missed.result["translation_error"] == pytest.approx(0.003, abs=0.0005)
        await bench.accept("placement.nudge", translation=[0.0, -0.003, 0.0])
        await bench.accept("mapping.repeat")
        assert await _after(bench, "mapping.perform") == "point_2"


@pytest.mark.nightly
async def test_map_of_skipped_points_says_so_and_the_next_starts_empty() -> None:
    async with mapping({"limits": {"point_tolerance_mm": 1e-6}}) as bench:
        await _go_to_next(bench)
        await bench.refuse("mapping.perform", "point_missed", decision="failed")
        for _ in range(3):
            ended = await bench.accept("mapping.skip")
        assert ended.state == "done"
        every = ["point_1", "point_2", "point_3"]
        assert ended.result == {"point": "point_3", "performed": [], "skipped": every, "points": 3}
        assert _behind(bench) == ((), tuple(every))
        await bench.accept("registration.register")
        assert (_at(bench), _behind(bench)) == ("point_1", ((), ()))
        assert await _after(bench, "mapping.skip") == "point_2"
        await bench.accept("mapping.plan_grid", poses=GRID)
        assert _behind(bench) == ((), ())


@pytest.mark.parametrize(
    ("state", "revoked", "begins"),
    [
        ("unplanned", False, True),
        ("ready", True, True),
        ("ready", False, False),
        ("stopped", False, False),
        ("done", False, False),
        ("abandoned", False, False),
    ],
)
def test_only_a_map_that_begins_has_no_points_behind_it(state: str, revoked: bool, begins: bool) -> None:
    data = Data(next_point=2, performed=("point_1",), skipped=("point_2",))
    effects = [Effect("revoke", "mapping", "", "done", "ready")] if revoked else []
    settled: Any = settle(data, {"mapping": state}, effects)
    assert (settled.performed, settled.skipped) == (((), ()) if begins else (("point_1",), ("point_2",)))
    assert settled.next_point == (0 if begins else 2)


def _at(bench: WorkflowBench) -> str:
    """The point that is next, stopped or not; otherwise the state."""
    data: Any = bench.data
    state = bench.states["mapping"]
    shown: dict[str, str] = {"ready": data.point, "stopped": f"{data.point}_stopped"}
    return shown.get(state, state)


async def _after(bench: WorkflowBench, name: str, **arguments: Any) -> str:
    await bench.accept(name, **arguments)
    return _at(bench)


def _behind(bench: WorkflowBench) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Points performed and skipped; the copied file has a class of its own for them."""
    data: Any = bench.data
    return data.performed, data.skipped


async def test_without_a_grid_nothing_can_be_performed_or_skipped() -> None:
    async with open_bench(workflow="grid_mapping") as bench:
        await bench.to_placed()
        for operation in ("perform", "skip", "repeat", "abandon"):
            await bench.refuse(f"mapping.{operation}", "invalid_in_state")
        await bench.refuse("toolplan.aim", "no_next_point")
        await bench.accept("mapping.plan_grid", poses=GRID)
        assert await _after(bench, "mapping.skip") == "point_2"
        assert (await bench.accept("mapping.reinit")).state == "unplanned"
        assert getattr(bench.data, "grid", None) == ()
        await bench.refuse("mapping.skip", "invalid_in_state")


async def test_no_point_is_performed_while_stop_is_latched() -> None:
    async with mapping() as bench:
        await _go_to_next(bench)
        await bench.dispatcher.stop("test")
        await bench.refuse("mapping.perform", "latched")
        await bench.accept("robot.acknowledge")
        assert await _after(bench, "mapping.perform") == "point_2"


@pytest.mark.nightly
async def test_the_commands_of_the_documentation_map_every_point() -> None:
    (section,) = re.findall(r"^## Grid mapping$(.*?)^## ", PAGE, re.MULTILINE | re.DOTALL)
    shown = re.findall(r"^\$ pcmrs call (\S+)", section.rpartition("```console")[2], re.MULTILINE)
    assert "mapping.perform" in shown
    async with mapping() as bench:
        for _ in GRID:
            for name in shown:
                await bench.accept(name)
        assert bench.states["mapping"] == "done"
        assert _behind(bench)[1] == ()


async def test_stop_in_the_middle_of_a_point_stops_the_point() -> None:
    async with mapping() as bench:
        await _go_to_next(bench)
        performing = asyncio.create_task(bench.do("mapping.perform"))
        await bench.until(lambda: bool(bench.dispatcher.snapshot().running))
        await bench.dispatcher.stop("test")
        assert (await performing).decision == "failed"
        assert _at(bench) == "point_1_stopped"
        await bench.accept("robot.acknowledge")
        await bench.accept("mapping.repeat")
        assert await _after(bench, "mapping.perform") == "point_2"


async def test_a_grid_that_does_not_fit_is_refused() -> None:
    async with open_bench(workflow="grid_mapping") as bench:
        await bench.refuse("mapping.plan_grid", "bad_arguments", poses=[])
        far = {**GRID[2], "position": [0.0, 0.0, 100.0]}
        await bench.refuse("mapping.plan_grid", "wrong_unit", poses=[*GRID[:2], far])
        flat = {**GRID[2], "quat_xyzw": [0.0, 0.0, 0.0, 0.0]}
        await bench.refuse("mapping.plan_grid", "bad_geometry", poses=[*GRID[:2], flat])


async def test_new_grid_restarts_and_new_registration_reopens_a_map() -> None:
    """The map was finished."""
    async with mapping() as bench:
        await bench.accept("mapping.skip")
        await bench.accept("registration.register")
        assert _at(bench) == "point_2", "a map under way goes on"
        for ending in ("skip", "skip"):
            await bench.accept(f"mapping.{ending}")
        await bench.accept("registration.register")
        assert _at(bench) == "point_1"
        await bench.accept("mapping.abandon")
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        assert _at(bench) == "point_1"
        await bench.accept("mapping.skip")
        assert await _after(bench, "mapping.plan_grid", poses=GRID) == "point_1"


async def test_a_new_plan_at_the_point_takes_the_tool_from_it() -> None:
    async with mapping() as bench:
        await _go_to_next(bench)
        await bench.accept("mapping.skip")
        await bench.accept("toolplan.aim")
        assert bench.states["placement"] == "replanned"
        await bench.refuse("mapping.perform", "not_at_point")


@pytest.mark.nightly
async def test_after_a_restart_a_grid_must_be_planned_again(tmp_path: Path) -> None:
    journal = Journal.open(tmp_path / "my_grid.sqlite", durable=False)
    blueprint = shipped_workflow("grid_mapping").blueprint
    tag = BlueprintTag(id=blueprint.id, version=blueprint.version, hash=blueprint.hash)
    recorder = JournalRecorder(journal, ManualClock(), "s1", tag)
    async with open_bench(workflow="grid_mapping", journal=recorder) as bench:
        await bench.register()
        await bench.accept("mapping.plan_grid", poses=GRID)
        await _perform(bench)
        registered = bench.data.previous
    again = recorder.previous(recorder.read_back(blueprint), shipped_workflow("grid_mapping").initial)
    assert registered is not None
    assert again.previous == registered
    assert getattr(again, "grid", None) == ()
    performed = [stored.row for stored in journal.reader.read(kind="outcome", branch="mapping")][-1]
    assert performed.verdict is not None
    assert performed.verdict.result is not None, "what was measured at a point outlives the daemon"
    assert performed.verdict.result["point"] == "point_1"
    await journal.close()


@pytest.mark.parametrize("count", [1, 16, 25])
async def test_a_grid_has_any_number_of_points(count: int) -> None:
    async with open_bench(workflow="grid_mapping") as bench:
        planned = await bench.accept("mapping.plan_grid", poses=(POSES * 3)[:count])
        assert planned.result == {"points": count}
        for number in range(1, count + 1):
            assert _at(bench) == f"point_{number}"
            await bench.accept("mapping.skip")
        assert bench.states["mapping"] == "done"


REQUIRED = 'requires = { registration = ["111"], toolplan = ["1"], robot = ["1"], placement = ["placed"] }\n'


@pytest.mark.parametrize(
    "weaker",
    ["", REQUIRED.replace('"placed"', '"placed", "standoff"'), REQUIRED.replace(', placement = ["placed"]', "")],
)
@pytest.mark.nightly
def test_verifier_finds_points_that_could_be_performed_elsewhere(weaker: str) -> None:
    file = find_workflow("grid_mapping").blueprint
    text = file.read_text()
    required = f'{REQUIRED}refusal = "not_at_point"'
    assert text.count(required) == 1
    assert examine(text.encode(), folder=file.parent).sound
    weakened = text.replace(required, f'{weaker}refusal = "not_at_point"')
    (finding,) = examine(weakened.encode(), folder=file.parent).findings
    assert finding.code == "property_violated"
    assert "point_only_in_place" in finding.text
    assert finding.commands is not None
    assert "mapping.perform" in finding.commands[-1]


async def test_checks_name_the_point_and_its_limits() -> None:
    async with mapping() as bench:
        plan_is_of_point(bench.run("mapping.perform"))
        await bench.accept("toolplan.plan", **GRID[1])
        with pytest.raises(RefusalError, match="not the pose of point_1") as refused:
            plan_is_of_point(bench.run("mapping.perform"))
        assert refused.value.refusal_code == "other_point_planned"
        run = bench.run("mapping.perform")
        limit_mm = bench.cell.settings.limits["point_tolerance_mm"]
        run.result |= {"translation_error": 0.001 * limit_mm, "rotation_error": 0.0}
        point_within_tolerance(run)
        for error in (0.0011 * limit_mm, float("nan")):
            run.result |= {"translation_error": error}
            with pytest.raises(RefusalError, match="from the planned pose of point_1") as missed:
                point_within_tolerance(run)
            assert missed.value.refusal_code == "point_missed"
        await bench.accept("mapping.abandon")
        with pytest.raises(RefusalError, match="is abandoned") as ended:
            point_reachable(bench.run("toolplan.aim"))
        assert ended.value.refusal_code == "no_next_point"
