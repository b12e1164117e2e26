"""What the arm keeps out of, on the simulated cell: refused before it moves, held when it drifts in."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import coal
import msgspec
import numpy as np
import pytest
from structlog.testing import capture_logs

from pcmrs.config import merge_tables
from pcmrs.errors import ConfigurationError, FileFormatError
from pcmrs.kinematics.arms import IIWA14_R820
from pcmrs.kinematics.collision import cylinder, hull, se3
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.sampled_clearance import BOUND
from pcmrs.messages import JointState, Verdict
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows.opening import open_workflow
from pcmrs.workflows.paths import along_axis
from pcmrs.workflows.placement import planned_pose
from pcmrs.workflows.settings import ProcedureSettings
from pcmrs.workflows.surface import read_surface
from pcmrs.workflows.toolplan import ToolPose, pose_of, standoff_postures
from pcmrs.workflows.zones import CellZones
from pcmrs_sim.head import CENTRE, SEMI_AXES
from tests import ROOT
from tests.unit.workflows.workflow_bench import LANDMARKS, POSES, WorkflowBench, open_bench

TETRAHEDRON = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0
100 0 0
0 100 0
0 0 100
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""


EXAMPLES = ROOT / "examples"


def lamp(position: Floats, size: float) -> dict[str, Any]:
    """A cube that stands in the cell, as its only box."""
    box = {"name": "lamp", "pose": {"position": position.tolist()}, "size": [size] * 3}
    return {"zones": {"boxes": [box]}}


def coil(bench: WorkflowBench, positions: list[float]) -> Floats:
    return np.asarray((bench.cell.arm.forward(positions) @ bench.cell.flange_from_coil).translation)


def reason(verdict: Verdict) -> dict[str, Any]:
    assert verdict.reason is not None
    return {"text": verdict.reason.text, **verdict.reason.fields}


async def recorded(bench: WorkflowBench, name: str) -> list[list[float]]:
    """The measured joints during an operation."""
    states: list[JointState] = []
    bench.cell.watchers.append(states.append)
    await bench.accept(name)
    bench.cell.watchers.remove(states.append)
    return [state.positions for state in states]


async def register(bench: WorkflowBench) -> None:
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.accept("digitization.digitize_all")
    await bench.accept("registration.register")


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


async def test_another_posture_is_taken_where_the_first_is_in_a_zone() -> None:
    async with open_bench() as bench:
        await bench.to_standoff()
        first = bench.cell.posture()
        elbow = bench.cell.arm.joint_origins(first)[3]
        seen = bench.cell.image_from_coil(bench.data).translation
    async with open_bench(lamp(elbow, 0.03)) as bench:
        await bench.to_standoff()
        assert np.abs(bench.cell.posture() - first).max() > 0.1
        assert np.linalg.norm(bench.cell.image_from_coil(bench.data).translation - seen) < 0.002


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
        spike = (
            base_from_image.inverse() @ cell.arm.forward(halfway) @ cell.flange_from_coil @ np.array((0.0, 0.0, 3e-3))
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


@pytest.mark.parametrize("name", ["ratms", "femoroplasty"])
def test_example_tools_keep_off_the_body_until_in_the_cone(name: str) -> None:
    defaults = merge_tables({"procedure": {}}, open_workflow(name).blueprint.defaults)
    own = msgspec.convert(defaults["procedure"], ProcedureSettings)
    surface = read_surface(own)
    assert surface is not None
    body, zones = hull(surface.vertices), own.zones
    tool = cylinder(zones.tool.radius, zones.tool.half_length, middle=zones.tool.half_length)
    for pose in json.loads((EXAMPLES / f"{name}_plan.json").read_text())["poses"]:
        image_from_target = Transform.from_quat_xyzw(pose["position"], pose["quat_xyzw"])
        for height in np.linspace(zones.cone_height, own.placement.standoff, 5):
            placed = se3(image_from_target @ along_axis(height)) * tool.pose
            found = coal.DistanceResult()
            shapes = (
                body.geometry,
                coal.Transform3s(),
                tool.geometry,
                coal.Transform3s(placed.rotation, placed.translation),
            )
            assert coal.distance(*shapes, coal.DistanceRequest(), found) > zones.body_margin + BOUND


def test_tool_pointing_away_moves_at_most_twice_the_bound() -> None:
    """No point of it moves farther between two samples."""
    tool = {"radius": 0.01, "half_length": 0.2}
    own = msgspec.convert({"zones": {"tool": tool}}, ProcedureSettings)
    flange_from_tool = Transform(np.eye(3), np.array((0.0, 0.0, 0.15)))
    zones = CellZones(IIWA14_R820, flange_from_tool, own, read_surface(own))
    postures = zones.sample_clearance([np.zeros(7), 0.5 * np.eye(7)[1]]).postures
    arm, end = ArmModel(IIWA14_R820), np.array((0.01, 0.0, 0.4))
    ends = np.array([arm.forward(q) @ flange_from_tool @ end for q in postures])
    assert np.linalg.norm(np.diff(ends, axis=0), axis=1).max() < 2.0 * BOUND


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


async def move_body_beside_elbow(bench: WorkflowBench) -> Floats:
    """Moves the head to 12 mm beside the elbow; returns by how much, in the tracker."""
    cell = bench.cell
    assert cell.base_from_tracker is not None
    assert cell.base_from_body_ref is not None
    assert cell.body_ref_from_image is not None
    elbow = cell.arm.joint_origins(cell.posture())[3]
    middle = cell.base_from_body_ref @ cell.body_ref_from_image @ CENTRE
    beside = elbow + np.array((0.0, cell.arm.facts.link_radius + SEMI_AXES[0] + 0.012, 0.0))
    offset = cell.base_from_tracker.rotation.T @ (beside - middle)
    await move_body(bench, offset)
    return np.asarray(offset)


async def move_body(bench: WorkflowBench, offset: Floats) -> None:
    x, y, z = offset.tolist()
    await bench.scene.move_body((x, y, z))


async def test_body_entering_a_motion_holds_it_and_allows_retreat(bench: WorkflowBench) -> None:
    await bench.to_standoff()
    async with bench.moving("placement.confirm") as confirm:
        offset = await move_body_beside_elbow(bench)
        verdict = await confirm
    told = reason(verdict)
    assert verdict.reason is not None
    assert (verdict.decision, verdict.reason.code, verdict.state) == ("failed", "zone_entered", "held")
    assert (told["zone"], told["link"][:4]) == ("body", "link")
    assert told["distance"] < told["limit"] == pytest.approx(0.025)
    assert bench.speed() < 1e-2
    assert not bench.cell.watchers
    await move_body(bench, -offset)
    await bench.clock.sleep(0.5)
    assert (await bench.accept("placement.back_off")).state == "standoff"


async def test_an_approach_is_held_where_the_body_comes_to_the_tool(bench: WorkflowBench) -> None:
    await bench.register()
    async with bench.moving("placement.approach") as approach:
        cell = bench.cell
        assert cell.base_from_tracker is not None
        assert cell.base_from_body_ref is not None
        assert cell.body_ref_from_image is not None
        middle = cell.base_from_body_ref @ cell.body_ref_from_image @ CENTRE
        point = cell.arm.forward(cell.posture()) @ cell.flange_from_coil @ np.array((0.0, 0.0, -SEMI_AXES[2]))
        await move_body(bench, cell.base_from_tracker.rotation.T @ (point - middle))
        verdict = await approach
    told = reason(verdict)
    assert verdict.reason is not None
    assert (verdict.decision, verdict.reason.code, verdict.state) == ("failed", "zone_entered", "held")
    assert told["link"] in ("tool", "mount")
    assert told["distance"] < told["limit"] == pytest.approx(0.025)
    assert bench.speed() < 1e-2


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
    async with open_bench({"body": {"surface": surface}, "motion": {"near_velocity": 0.04}}) as bench:
        await bench.to_standoff()
        points = np.array([coil(bench, q) for q in await recorded(bench, "placement.confirm")])
        speeds = np.linalg.norm(np.diff(points, axis=0), axis=1) * 100.0  # states come at 100 Hz
        assert 0.035 < speeds.max() < 0.042


@pytest.mark.parametrize("operation", ["placement.approach", "placement.home"])
async def test_near_the_body_every_way_is_slow_and_elsewhere_it_is_not(operation: str) -> None:
    """SR8: also of the ways that lead from and to places far from the body."""
    async with open_bench({"motion": {"near_velocity": 0.04, "near_distance": 0.1}}) as bench:
        await (bench.to_standoff() if operation == "placement.home" else bench.register())
        postures = np.array(await recorded(bench, operation))
        flanges = [bench.cell.arm.forward(q) for q in postures]
        points = np.array([(each.translation, each @ bench.cell.flange_from_coil.translation) for each in flanges])
        speeds = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1) * 100.0  # states come at 100 Hz
        near = bench.cell.zones.near_body(postures, 0.1)
        slow = near[1:] & near[:-1]
        assert 0.035 < speeds[slow].max() < 0.042
        assert speeds[~slow].max() > 0.1


def settings_with(**body: Any) -> ProcedureSettings:
    return msgspec.convert({"body": body}, ProcedureSettings)


def test_missing_surface_is_logged_at_the_start() -> None:
    with capture_logs() as logs:
        assert read_surface(settings_with()) is None
    assert [log["event"] for log in logs] == ["no_body_surface"]


def test_surface_is_found_in_the_folders_then_among_examples(tmp_path: Path) -> None:
    (tmp_path / "own.ply").write_text(TETRAHEDRON)
    own = read_surface(settings_with(surface="own.ply", folders=[str(tmp_path)], unit="mm", space="LPS"))
    assert own is not None
    assert own.vertices.min(axis=0) == pytest.approx((-0.1, -0.1, 0.0))
    assert read_surface(settings_with(surface=str(tmp_path / "own.ply"))) is not None
    head = read_surface(settings_with(surface="head_phantom.ply", folders=[str(tmp_path)]))
    assert head is not None
    assert np.ptp(head.vertices, axis=0) == pytest.approx((0.156, 0.196, 0.216), abs=0.06)
    with pytest.raises(ConfigurationError, match=r"there is no .*nobody\.ply"):
        read_surface(settings_with(surface="nobody.ply"))
    (tmp_path / "own.ply").write_text("ply")
    with pytest.raises(FileFormatError):
        read_surface(settings_with(surface="own.ply", folders=[str(tmp_path)]))


def test_a_phantom_is_no_patient() -> None:
    mine = msgspec.structs.replace(settings_with(surface="head_phantom.ply"), patient="P-17")
    with pytest.raises(ConfigurationError, match=r"phantom's, but the patient is P-17: set it to the patient's own"):
        read_surface(mine)


@pytest.mark.parametrize("name", ["body", "tool", "sight_of_tool"])
def test_boxes_have_names_of_their_own(name: str) -> None:
    box = {"name": name, "pose": {}, "size": [0.1, 0.1, 0.1]}
    with pytest.raises(msgspec.ValidationError, match="a unique name"):
        msgspec.convert({"zones": {"boxes": [box]}}, ProcedureSettings)


async def test_nearest_of_all_refused_postures_gives_the_reason() -> None:
    """Of five postures four have the elbow in a box: what is wrong with the way of the other is the reason."""
    async with open_bench() as bench:
        await bench.register()
        postures = list(standoff_postures(bench.run("placement.approach"), pose_of(ToolPose(**POSES[6]))))
        elbows = [bench.cell.arm.joint_origins(posture)[3] for posture in postures]
    assert len(elbows) == 5
    boxes = [
        {"name": f"lamp_{number}", "pose": {"position": elbow.tolist()}, "size": [0.01] * 3}
        for number, elbow in enumerate(elbows[1:])
    ]
    narrow = {"zones": {"cone_height": 0.2, "cone_half_angle_deg": 5.0, "boxes": boxes}}
    async with open_bench(narrow) as bench:
        await bench.register()
        await bench.accept("toolplan.plan", **POSES[6])
        run = bench.run("placement.approach")
        (posture,) = standoff_postures(run, planned_pose(bench.data))
        assert np.abs(posture - postures[0]).max() < 0.02
        await bench.refuse("placement.approach", "outside_cone")
