"""Motions that are planned in a process beside the daemon: the same answers, and a process that is lost or late."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
import pytest
import pytest_asyncio
from anyio.from_thread import BlockingPortal, start_blocking_portal

from pcmrs.clock import SystemClock
from pcmrs.dispatcher import Run
from pcmrs.dispatcher.command_checks import read_payload
from pcmrs.dispatcher.execution import refusal
from pcmrs.messages import Command, DeviceEvent, Reason
from pcmrs.processes.starting import start_by_exec
from pcmrs.service.processes import planner as planner_module
from pcmrs.service.processes.planner import PlanningProcess
from pcmrs.service.supervisor import Supervisor
from pcmrs.settings import Settings
from pcmrs.spatial import Transform
from pcmrs.workflows._correction import CORRECTION_TIME, CorrectionLine, correction_possible
from tests import ROOT
from tests.support.shipped import shipped_workflow
from tests.unit.workflows.workflow_bench import POSES, WorkflowBench, open_bench

FAR = POSES[0] | {"position": [0.9, 0.9, 0.9]}
ANSWERS = pytest.mark.asyncio(loop_scope="module")
"""For tests that share a process."""


def on_the_machine(work: Coroutine[Any, Any, None]) -> None:
    """Runs what needs a child process in a loop of the machine; simulated time stands still meanwhile."""

    def run() -> None:
        with asyncio.Runner(loop_factory=asyncio.SelectorEventLoop) as runner:
            runner.run(work)

    with ThreadPoolExecutor(1) as pool:
        pool.submit(run).result()


@asynccontextmanager
async def planning(
    bench: WorkflowBench, workflow: str = "ratms"
) -> AsyncIterator[tuple[PlanningProcess, asyncio.Queue[DeviceEvent]]]:
    """A process that plans for the cell of a bench, and what is reported of it."""
    clock, events = SystemClock(), asyncio.Queue[DeviceEvent]()
    planner = PlanningProcess(Settings(workflow=workflow, procedure=bench.cell.settings), clock, start_by_exec)
    planner.report = events.put_nowait
    try:
        async with Supervisor(clock) as supervisor:
            planner.start(supervisor, shipped_workflow("ratms").blueprint, bench.cell)
            await planner.wait()
            yield planner, events
    finally:
        await planner.stop()


def run_of(bench: WorkflowBench, name: str, **arguments: Any) -> Run[Any, Any]:
    branch, operation = name.split(".")
    command = Command(id="asked", branch=branch, operation=operation, source="test:user", arguments=arguments)
    workflow, cell = shipped_workflow("ratms"), bench.cell
    spec = workflow.blueprint.branches[branch].operations[operation]
    payload = read_payload(workflow, command, spec)
    return Run(command, payload, bench.states, cell, cell.clock, bench.data, lambda _: None, spec.motion)


def checks_of(run: Run[Any, Any]) -> list[str]:
    blueprint, command = shipped_workflow("ratms").blueprint, run.command
    return list(blueprint.branches[command.branch].operations[command.operation].checks)


async def check(planner: PlanningProcess, run: Run[Any, Any]) -> Reason | None:
    return await planner.check(run, checks_of(run))


def correction_of(bench: WorkflowBench, shift: npt.ArrayLike = (0.003, 0.0, 0.0)) -> Run[Any, Any]:
    """A run whose step asks for the line by which the tool is shifted in its own frame, m."""
    cell, run = bench.cell, run_of(bench, "placement.confirm")
    here = cell.arm.forward(cell.posture()) @ cell.flange_from_tool_tip
    run.prepared = CorrectionLine(cell.posture(), here @ Transform.from_rotvec(shift, np.zeros(3)))
    return run


def in_the_loop(run: Run[Any, Any]) -> Reason | None:
    return refusal(shipped_workflow("ratms").registry, checks_of(run), run)


def pid_of(planner: PlanningProcess) -> int:
    assert planner._process is not None
    return planner._process.pid


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def registered() -> AsyncIterator[WorkflowBench]:
    """A registered head, for tests in which a process only answers."""
    async with open_bench() as bench:
        await bench.register()
        yield bench


Answering = tuple[BlockingPortal, PlanningProcess]
"""The loop of a planning process, and the process."""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def answering(registered: WorkflowBench, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Answering]:
    """One process for all of these tests. The file of its workflow is changed after the daemon has verified it."""
    changed = tmp_path_factory.mktemp("changed") / "ratms.toml"
    changed.write_text("this is being edited")
    with start_blocking_portal() as portal:
        opened = planning(registered, str(changed))
        with portal.wrap_async_context_manager(opened) as (planner, events):
            yield portal, planner
            assert events.empty()
            assert portal.call(_end_as_its_daemon_is_killed, planner) == 0


async def _end_as_its_daemon_is_killed(planner: PlanningProcess) -> int:
    process = planner._process
    assert process is not None
    assert process.stdin is not None
    process.stdin.close()
    return await process.wait()


@ANSWERS
async def test_it_answers_as_the_checks_do_in_the_loop(registered: WorkflowBench, answering: Answering) -> None:
    portal, planner = answering
    here, there = run_of(registered, "placement.approach"), run_of(registered, "placement.approach")
    assert in_the_loop(here) is None
    assert portal.call(check, planner, there) is None
    np.testing.assert_allclose(there.prepared.positions, here.prepared.positions, atol=1e-9)
    for pose in (POSES[1], FAR):
        here, there = run_of(registered, "toolplan.plan", **pose), run_of(registered, "toolplan.plan", **pose)
        assert portal.call(check, planner, there) == in_the_loop(here)
        assert there.result == here.result
    assert in_the_loop(here) is not None


@ANSWERS
async def test_it_plans_a_correction_as_the_loop_would(registered: WorkflowBench, answering: Answering) -> None:
    portal, planner = answering
    here, there = correction_of(registered), correction_of(registered)
    correction_possible(here)
    assert portal.call(planner.check, there, ["correction_possible"], CORRECTION_TIME) is None
    np.testing.assert_allclose(there.prepared.positions, here.prepared.positions, atol=1e-9)
    assert len(there.prepared.positions) > 1
    far = correction_of(registered)
    far.prepared = replace(far.prepared, base_from_tool_tip=Transform.from_rotvec((0.9, 0.9, 0.9), (0.0, 0.0, 0.0)))
    refused = portal.call(planner.check, far, ["correction_possible"], CORRECTION_TIME)
    assert refused is not None
    assert refused.code == "unreachable"


@ANSWERS
async def test_it_runs_the_blueprint_that_the_daemon_has_verified(
    registered: WorkflowBench, answering: Answering
) -> None:
    """A file that is changed before the process is restarted must not give it another workflow than the daemon's."""
    portal, planner = answering
    assert planner._settings.workflow != "ratms"
    assert portal.call(check, planner, run_of(registered, "placement.approach")) is None


@ANSWERS
@pytest.mark.parametrize("corrects", [False, True])
async def test_arm_that_moved_during_planning_is_planned_for_again(
    registered: WorkflowBench, answering: Answering, monkeypatch: pytest.MonkeyPatch, corrects: bool
) -> None:
    portal, planner = answering

    async def ask() -> Reason | None:
        run = correction_of(registered) if corrects else run_of(registered, "placement.approach")
        asked = asyncio.ensure_future(planner.check(run, ["correction_possible"] if corrects else checks_of(run)))
        await asyncio.sleep(0)  # the request has been sent
        assert registered.cell.joints is not None
        elsewhere = [position + 0.02 for position in registered.cell.joints.positions]
        moved = msgspec.structs.replace(registered.cell.joints, positions=elsewhere)
        monkeypatch.setattr(registered.cell, "joints", moved)
        return await asked

    reason = portal.call(ask)
    assert reason is not None
    assert reason.code == "moved_while_planning"


async def test_it_keeps_away_from_the_body_that_the_daemon_has_read(tmp_path: Path) -> None:
    """A file that is replaced or gone when the process is restarted must not give it another body than the guard's."""
    file = tmp_path / "body.ply"
    shutil.copy(ROOT / "examples" / "head_phantom.ply", file)

    async def ask(bench: WorkflowBench) -> None:
        file.unlink()
        async with planning(bench) as (planner, _):
            assert await check(planner, run_of(bench, "placement.approach")) is None

    async with open_bench({"body": {"surface": str(file)}}) as bench:
        await bench.register()
        on_the_machine(ask(bench))


async def test_a_process_that_is_killed_is_a_refusal_and_restarted() -> None:
    async def ask(bench: WorkflowBench) -> None:
        async with planning(bench) as (planner, events):
            os.kill(pid_of(planner), signal.SIGSTOP)
            asked = asyncio.ensure_future(check(planner, run_of(bench, "placement.approach")))
            await asyncio.sleep(0)
            os.kill(pid_of(planner), signal.SIGKILL)
            lost = await asked
            assert lost is not None
            assert lost.code == "planner_lost"
            absent = await check(planner, run_of(bench, "placement.approach"))
            assert absent is not None
            assert absent.code == "planner_lost"
            await planner.wait()
            assert await check(planner, run_of(bench, "placement.approach")) is None
            assert (await events.get()).code == "planner_restarted"
            assert events.empty()

    async with open_bench() as bench:
        await bench.register()
        on_the_machine(ask(bench))


async def test_a_process_that_hangs_is_a_refusal_and_restarted(monkeypatch: pytest.MonkeyPatch) -> None:
    async def ask(bench: WorkflowBench) -> None:
        async with planning(bench) as (planner, events):
            monkeypatch.setattr(planner_module, "PLANNING_TIME", 0.2)
            os.kill(pid_of(planner), signal.SIGSTOP)
            late = await check(planner, run_of(bench, "placement.approach"))
            assert late is not None
            assert late.code == "planner_late"
            monkeypatch.undo()
            assert (await events.get()).code == "planner_restarted"
            await planner.wait()
            assert await check(planner, run_of(bench, "placement.approach")) is None

    async with open_bench() as bench:
        await bench.register()
        on_the_machine(ask(bench))


async def test_a_correction_that_is_late_has_its_own_limit() -> None:
    async def ask(bench: WorkflowBench) -> None:
        async with planning(bench) as (planner, events):
            os.kill(pid_of(planner), signal.SIGSTOP)
            late = await planner.check(correction_of(bench), ["correction_possible"], 0.2)
            assert late is not None
            assert (late.code, late.fields) == ("planner_late", {"limit": 0.2})
            assert (await events.get()).code == "planner_restarted"

    async with open_bench() as bench:
        await bench.register()
        on_the_machine(ask(bench))


def test_it_ends_silently_if_the_daemon_is_gone_before_settings() -> None:
    command = [sys.executable, "-m", "pcmrs.workflows.planning_process"]
    ended = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=60, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, b"", b"")
