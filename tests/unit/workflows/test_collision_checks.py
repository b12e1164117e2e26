"""Paths keep out of the zones and are slow near the body; limits of a motion are computed in parts."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.settings import Settings
from pcmrs.spatial import Floats
from pcmrs.workflows._collision_checks import SAMPLES_PER_PART, ClearanceLimits
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.planning import PlanningCell
from pcmrs.workflows.surface import read_surface
from tests.support.shipped import shipped_workflow
from tests.unit.workflows.workflow_bench import POSES, WorkflowBench, open_bench
from tests.unit.workflows.zone_bench import coil, lamp, reason, recorded, register, settings_with

SAMPLES = 10 * SAMPLES_PER_PART + 7
STATE_RATE_HZ = 100.0
FREQUENT_STATES = {"arm": {"state_rate_hz": STATE_RATE_HZ}}


@pytest.fixture(scope="module")
def cell() -> Cell:
    settings = Settings()
    planning = PlanningCell(
        shipped_workflow(settings.workflow),
        settings.procedure,
        ArmModel(find_arm(settings.robot.model)),
        read_surface(settings.procedure),
        Mounting.read(settings.procedure.calibration),
    )
    return planning._cell


async def test_plan_in_a_zone_is_refused_with_zone_and_posture() -> None:
    async with open_bench() as bench:
        await bench.to_standoff()
        at_standoff = coil(bench, bench.cell.posture().tolist())
    async with open_bench(lamp(at_standoff, 0.10)) as bench:
        await bench.connect()
        await bench.accept("toolplan.plan", **POSES[0])
        await register(bench)
        for name, arguments in (("placement.approach", {}), ("toolplan.plan", POSES[0])):
            told = reason(await bench.refuse(name, "zone_violated", **arguments))
            assert told["zone"] == "lamp"
            assert told["link"] in ("tool", "mount", "link_7", "link_6")
            assert told["distance"] < told["limit"] == pytest.approx(0.020)
            assert len(told["joints_deg"]) == 7
            for named in ("lamp", told["link"], "20 mm", str(told["joints_deg"])):
                assert named in told["text"]


async def test_a_way_through_a_zone_is_refused_though_it_ends_outside() -> None:
    async with open_bench() as bench:
        await bench.register()
        await bench.accept("toolplan.plan", **POSES[7])
        way = await recorded(bench, "placement.approach")
        beyond_half = coil(bench, way[len(way) * 11 // 20])  # before that, another posture goes round it
    async with open_bench(lamp(beyond_half, 0.10)) as bench:
        await bench.connect()
        await register(bench)
        await bench.accept("toolplan.plan", **POSES[7])
        assert reason(await bench.refuse("placement.approach", "zone_violated"))["zone"] == "lamp"


def write_points(file: Path, points: Floats) -> None:
    """A mesh with these corners; which ones its triangles join does not matter to its hull."""
    corners = "".join("{:.9f} {:.9f} {:.9f}\n".format(*point) for point in points)
    triangles = "".join(f"3 {first} {first + 1} {first + 2}\n" for first in range(len(points) - 2))
    axes = "property float x\nproperty float y\nproperty float z\n"
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{axes}element face {len(points) - 2}\n"
    file.write_text(f"{head}property list uchar int vertex_indices\nend_header\n{corners}{triangles}")


async def test_the_tool_keeps_off_the_body_away_from_its_target(tmp_path: Path) -> None:
    pose, file = POSES[5], tmp_path / "spiked.ply"
    async with open_bench() as bench:
        await bench.register()
        await bench.accept("toolplan.plan", **pose)
        way = await recorded(bench, "placement.approach")
        cell, halfway = bench.cell, way[int(0.55 * len(way))]
        assert cell.base_from_body_ref is not None
        assert cell.body_ref_from_image is not None
        base_from_image = cell.base_from_body_ref @ cell.body_ref_from_image
        spike = (base_from_image.inverse() @ cell.arm.forward(halfway) @ cell.flange_from_tool_tip) @ np.array(
            (0.0, 0.0, 3e-3)
        )
    head = read_surface(settings_with(surface="head_phantom.ply"))
    assert head is not None
    write_points(file, np.vstack((head.vertices, spike)))
    async with open_bench({"body": {"surface": str(file)}}) as bench:
        await bench.connect()
        await register(bench)
        await bench.accept("toolplan.plan", **pose)
        told = reason(await bench.refuse("placement.approach", "zone_violated"))
        assert told["link"] in ("tool", "mount")
        assert (told["zone"], told["limit"]) == ("body", 0.030)
        tool = base_from_image.inverse() @ coil(bench, np.radians(told["joints_deg"]).tolist())
        assert np.linalg.norm(tool - pose["position"]) > bench.cell.zones.cone.height
        bench.cell.zones.limits_afar = bench.cell.zones.limits  # nothing else keeps it off
        clipping = await recorded(bench, "placement.approach")
        pair = bench.cell.zones.model.pairs.index(("tool", "body"))
        assert min(bench.cell.zones.model.distances(q)[pair] for q in clipping) < 0.0


async def test_the_tool_comes_to_the_body_through_the_cone_only() -> None:
    async with open_bench({"zones": {"cone_height": 0.2, "cone_half_angle_deg": 5.0}}) as bench:
        await bench.register()
        await bench.accept("toolplan.plan", **POSES[6])
        told = reason(await bench.refuse("placement.approach", "outside_cone"))
        assert told["excess"] > 0.0
        assert "5°" in told["text"]


async def test_a_nudge_that_presses_deeper_than_allowed_is_refused(bench: WorkflowBench) -> None:
    await bench.to_placed()
    told = reason(await bench.refuse("placement.nudge", "outside_cone", translation=[0.0, 0.0, -0.018]))
    assert told["height"] == pytest.approx(-0.018, abs=0.001)
    await bench.accept("placement.nudge", translation=[0.0, 0.0, -0.005])


async def test_a_tool_too_near_may_back_off_but_not_approach() -> None:
    async with open_bench() as bench:
        await bench.to_placed()
        placed = bench.cell.posture().tolist()
    wide = {"zones": {"body_margin": 0.12}}
    async with open_bench(wide, {"arm": {"home": placed}}) as bench:
        await bench.connect()
        await register(bench)
        assert bench.states["placement"] == "held"
        assert (await bench.accept("placement.back_off")).state == "retracted"
        assert reason(await bench.refuse("toolplan.plan", "zone_violated", **POSES[0]))["zone"] == "body"


@pytest.mark.parametrize("surface", ["head_phantom.ply", ""])
async def test_the_last_way_to_the_body_is_slow(surface: str) -> None:
    """Also where nobody knows the body's surface."""
    slow = {"body": {"surface": surface}, "motion": {"near_velocity": 0.04}}
    async with open_bench(slow, FREQUENT_STATES) as bench:
        await bench.to_standoff()
        points = np.array([coil(bench, q) for q in await recorded(bench, "placement.confirm")])
        speeds = np.linalg.norm(np.diff(points, axis=0), axis=1) * STATE_RATE_HZ
        assert 0.035 < speeds.max() < 0.042


@pytest.mark.parametrize("operation", ["placement.approach", "placement.home"])
async def test_near_the_body_every_way_is_slow_and_elsewhere_it_is_not(operation: str) -> None:
    """SR8: also of the ways that lead from and to places far from the body."""
    async with open_bench({"motion": {"near_velocity": 0.04, "near_distance": 0.1}}, FREQUENT_STATES) as bench:
        await (bench.to_standoff() if operation == "placement.home" else bench.register())
        postures = np.array(await recorded(bench, operation))
        flanges = [bench.cell.arm.forward(q) for q in postures]
        points = np.array([(each.translation, each @ bench.cell.flange_from_tool_tip.translation) for each in flanges])
        speeds = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1) * STATE_RATE_HZ
        near = bench.cell.zones.near_body(postures, 0.1)
        slow = near[1:] & near[:-1]
        assert 0.035 < speeds[slow].max() < 0.042
        assert speeds[~slow].max() > 0.1


async def test_parts_find_what_the_whole_way_shows(cell: Cell) -> None:
    home = np.array(cell.home)
    turn = np.array([0.9, 0.4, 0.0, -0.5, 0.0, 0.3, 0.0])
    way = home + np.linspace(0.0, 1.0, SAMPLES)[:, None] * turn
    limits = await ClearanceLimits.along_motion(cell, way)
    planned = cell.zones.sample_clearance(way).distances.min(axis=0)
    np.testing.assert_allclose(limits._limits, ClearanceLimits(cell, planned)._limits, atol=2e-3)
    at_home = ClearanceLimits.at_posture(cell, home)._limits
    np.testing.assert_allclose(at_home, ClearanceLimits(cell, cell.zones.sample_clearance([home]).distances[0])._limits)


async def test_loop_runs_between_the_parts(cell: Cell) -> None:
    way = np.tile(cell.home, (SAMPLES, 1))
    turns = 0

    async def count() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    counting = asyncio.create_task(count())
    await ClearanceLimits.along_motion(cell, way)
    counting.cancel()
    assert turns >= SAMPLES // SAMPLES_PER_PART
