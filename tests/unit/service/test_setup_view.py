"""What a console shows of a cell: its setup in SI units, and the data of the procedure as far as there are any."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import numpy as np

from pcmrs.fsm import parse_blueprint
from pcmrs.service._setup_view import gathered, setup_of
from pcmrs.settings import Settings
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.workflows.data import as_transform
from tests import ROOT
from tests.support.shipped import shipped_workflow
from tests.unit.workflows.workflow_bench import LANDMARKS, WorkflowBench, open_bench


def on_a_bench(work: Callable[[WorkflowBench], Awaitable[None]], surface: str = "") -> None:
    async def run() -> None:
        async with open_bench({"body": {"surface": surface}}) as bench:
            await work(bench)

    with asyncio.Runner(loop_factory=SimulatedLoop) as runner:
        runner.run(run())


def test_setup_is_that_of_the_cell_in_metres() -> None:
    async def look(bench: WorkflowBench) -> None:
        workflow = shipped_workflow("ratms")
        blueprint = workflow.blueprint
        settings = Settings(procedure=bench.cell.settings)
        shown = setup_of(bench.cell, settings, workflow)
        assert {spec.payload for branch in blueprint.branches.values() for spec in branch.operations.values()} <= set(
            shown.arguments
        )
        assert shown.residual_limit == bench.cell.settings.registration.residual_limit_mm * 1e-3
        assert shown.tre_limit == bench.cell.settings.registration.tre_limit_mm * 1e-3
        assert parse_blueprint(shown.blueprint.encode(), origin="shown").hash == blueprint.hash
        assert len(shown.arm.joints) == len(bench.cell.posture())
        mounted = as_transform(shown.flange_from_coil).matrix
        np.testing.assert_allclose(mounted, bench.cell.flange_from_tool_tip.matrix, atol=1e-12)
        tip = as_transform(shown.tool_marker_from_tool_tip).matrix
        np.testing.assert_allclose(tip, bench.cell.mounting.tool_marker_from_tool_tip.matrix, atol=1e-12)
        assert shown.drivers == dict.fromkeys(Settings().drivers()["sim"], "sim")
        assert (shown.role, shown.lease_required) == ("viewer", False), "until a client says who it is"
        assert shown.surface is not None
        mesh = bench.cell.surface
        assert mesh is not None
        vertices = np.frombuffer(shown.surface.vertices, "<f4").reshape(-1, 3)
        faces = np.frombuffer(shown.surface.faces, "<u4").reshape(-1, 3)
        np.testing.assert_allclose(vertices, mesh.vertices, atol=1e-6)
        np.testing.assert_array_equal(faces, mesh.faces)

    on_a_bench(look, str(ROOT / "examples" / "head_phantom.ply"))


def test_data_show_what_is_known_and_nothing_else() -> None:
    async def look(bench: WorkflowBench) -> None:
        before = gathered(bench.cell, bench.data)
        assert (before.landmarks, before.plan, before.residual, before.body_ref_from_image) == ([], None, None, None)
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        planned = gathered(bench.cell, bench.data).landmarks
        assert [(each.name, each.digitized) for each in planned] == [(each["name"], None) for each in LANDMARKS]
        await bench.register()
        after = gathered(bench.cell, bench.data)
        registered = bench.data.registered
        assert registered is not None
        assert [each.digitized for each in after.landmarks] == list(registered.digitized)
        assert (after.residual, after.body_ref_from_image) == (registered.residual, registered.body_ref_from_image)
        assert after.plan == bench.data.plan
        assert after.sigma is not None
        assert after.sigma > 0.0

    on_a_bench(look)
