"""A guided tool moves as the engaged teleoperator asks, and stands whenever there is doubt."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import NoReturn

import msgspec
import numpy as np
import pytest

from pcmrs.errors import RefusalError
from pcmrs.kinematics.zones import TOOL
from pcmrs.messages import Command
from pcmrs.messages.teleop import AT_REST, Twist
from pcmrs.spatial import Floats, Frame, distance, rotation_angle
from pcmrs.workflows import read_workflow
from pcmrs.workflows._guided_tool import GuidedTool
from pcmrs.workflows._teleoperation import Activity, GuidanceSession, planned_in_body_ref
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.settings import TeleoperationSettings
from pcmrs.workflows.zones import BODY
from tests.unit.teleop.guided_bench import PERIOD, Teleoperator, danger, guided, held, moved, still, tool
from tests.unit.workflows.workflow_bench import WorkflowBench, open_bench

SETTINGS = TeleoperationSettings()
UP: Twist = (0.0, 0.0, 0.01, 0.0, 0.0, 0.0)
AWAY: Twist = (0.0, 0.0, 0.5, 0.0, 0.0, 0.0)
DOWN: Twist = (0.0, 0.0, -0.5, 0.0, 0.0, 0.0)
ASIDE: Twist = (0.01, 0.0, 0.0, 0.0, 0.0, 0.1)
MOVES = 1e-3
"""A tool that was to move has gone farther than this, m."""


@pytest.fixture
async def alice() -> AsyncIterator[Teleoperator]:
    """A teleoperator of a tool at the standoff."""
    async with open_bench() as bench:
        yield await guided(bench)


async def test_tool_moves_as_requested_while_the_clutch_is_engaged(alice: Teleoperator) -> None:
    bench, before = alice.bench, await tool(alice.bench)
    async with alice.sending():
        await alice.steer(UP, 0.3)
        assert await still(bench, before), "the clutch is open"
        await alice.engage()
        await alice.steer(UP, 1.0)
        assert await moved(bench, before) == pytest.approx((0.0, 0.0, 0.010), abs=0.001)
        before = await tool(bench)
        await alice.steer(ASIDE, 1.0)
        after = await tool(bench)
        assert rotation_angle(before, after) == pytest.approx(0.1, abs=0.01)
        assert await moved(bench, before) == pytest.approx((0.010, 0.0005, 0.0), abs=0.001)
        assert alice.status.user == "alice"
        assert 0.0 < (alice.status.round_trip or 0.0) <= 2 * PERIOD
        alice.twist = UP
        await bench.clock.sleep(0.3)
        assert (await alice.ask("teleoperation.release")).decision == "accepted"
        await bench.until(lambda: bench.speed() < 1e-3)
        await bench.until(lambda: alice.status.user is None)
        assert bench.states["placement"] == "guided"
        before = await tool(bench)
        await bench.clock.sleep(0.5)
        assert await still(bench, before), "released, and it is still asked to go on"
        await alice.engage()
        await bench.clock.sleep(0.5)
        assert (await moved(bench, before))[2] > MOVES, "engaged anew"
        assert (await bench.accept("placement.home")).state == "retracted"
    assert not bench.dispatcher.snapshot().latched


async def test_silence_holds_and_latches_and_nothing_resumes_by_itself(alice: Teleoperator) -> None:
    bench = alice.bench
    await alice.engage()
    async with alice.sending():
        alice.twist = UP
        await bench.clock.sleep(0.5)
        last = bench.clock.monotonic()
    await bench.until(lambda: bench.dispatcher.snapshot().latched)
    assert bench.clock.monotonic() - last < SETTINGS.deadman + 2 * PERIOD
    await held(bench)
    assert danger(bench).code == "teleoperator_lost"
    assert bench.states["teleoperation"] == "off"
    before = await tool(bench)
    async with alice.sending():
        for name in ("teleoperation.engage", "placement.guide", "placement.back_off"):
            assert (await alice.ask(name)).decision == "rejected"
        await bench.accept("robot.acknowledge")
        await bench.clock.sleep(0.5)
        assert await still(bench, before)
    assert (await bench.accept("placement.back_off")).state in ("standoff", "retracted")


async def test_foreign_stale_or_repeated_set_points_have_no_effect(alice: Teleoperator) -> None:
    bench = alice.bench
    await alice.engage()
    async with alice.sending():
        await bench.clock.sleep(0.2)
        before = await tool(bench)
        eve = Teleoperator(bench, user="eve", heard=alice.heard, twist=UP, sequence=10_000)
        forged = [
            alice.made(UP, seen=alice.now + 1.0),
            alice.made(UP, seen=alice.heard[0].stamp),
            alice.made(UP, sequence=1),
            alice.made(UP, seen=alice.now - 0.15, ttl=0.1),
        ]
        async with eve.sending():
            for setpoint in forged * 20:
                alice.send(setpoint)
                await bench.clock.sleep(0.005)
        assert await still(bench, before)
        refused = alice.status.refused
        assert refused["other_user"] >= 15
        codes = ("from_the_future", "before_engagement", "out_of_sequence", "expired")
        assert {code: refused[code] >= 15 for code in codes} == dict.fromkeys(codes, True)
        assert bench.states["teleoperation"] == "engaged"
    async with eve.sending():
        await held(bench)
    assert danger(bench).code == "teleoperator_lost"


async def test_handed_over_clutch_counts_for_the_new_hand_only(alice: Teleoperator) -> None:
    bench, bob = alice.bench, Teleoperator(alice.bench, user="bob", heard=alice.heard)
    await alice.engage()
    async with alice.sending(), bob.sending():
        await bench.clock.sleep(0.2)
        assert (await alice.ask("teleoperation.release")).decision == "accepted"
        await bob.engage()
        before = await tool(bench)
        alice.twist = UP
        await bench.clock.sleep(0.5)
        assert alice.status.user == "bob"
        assert await still(bench, before)
        alice.twist = AT_REST
        bob.twist = UP
        await bench.clock.sleep(0.5)
        assert (await moved(bench, before))[2] > MOVES


async def test_late_teleoperator_is_slowed_then_held_until_release(alice: Teleoperator) -> None:
    bench = alice.bench
    await alice.engage()
    async with alice.sending():
        alice.twist = UP
        await alice.fall_behind(0.28)
        assert 0.3 < alice.status.scale < 0.7
        before = await tool(bench)
        await bench.clock.sleep(1.0)
        assert 0.003 < (await moved(bench, before))[2] < 0.007
        await alice.fall_behind(0.55)
        await bench.until(lambda: bench.speed() < 1e-3)
        assert alice.status.held
        alice.late = 0.0
        before = await tool(bench)
        await bench.clock.sleep(0.7)
        assert alice.status.held
        assert await still(bench, before), "it is still asked to go on"
        alice.twist = AT_REST
        await bench.until(lambda: not alice.status.held)
        alice.twist = UP
        await bench.clock.sleep(0.5)
        assert (await moved(bench, before))[2] > MOVES
        assert bench.states["teleoperation"] == "engaged"


async def test_stop_wins_over_a_teleoperator(alice: Teleoperator) -> None:
    bench = alice.bench
    await alice.engage()
    async with alice.sending():
        alice.twist = UP
        await bench.clock.sleep(0.5)
        assert await bench.dispatcher.stop("bus:eve")
        await held(bench)
        assert (await alice.ask("teleoperation.engage")).decision == "rejected"
    assert danger(bench).code == "stopped"


async def test_the_tool_stays_above_the_contact_and_near_its_place() -> None:
    async with open_bench({"teleoperation": {"range": 0.075}}) as bench:
        alice = await guided(bench, placed=True)
        await alice.engage()
        async with alice.sending():
            for twist in (DOWN, (0.0, 0.0, 0.0, 0.0, 1.0, 0.0)):
                await alice.steer(twist, 0.2)
            assert await bench.true_height() > -0.001
            alice.twist = AWAY
            await bench.until(lambda: alice.status.limit == "range")
            assert await bench.true_height() == pytest.approx(0.075, abs=0.001)
            alice.twist = DOWN
            await bench.clock.sleep(5.0)
            assert alice.status.limit in ("height", "zone")
            assert await bench.true_height() == pytest.approx(0.0, abs=0.001)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(5))
async def test_no_steering_brings_the_tool_nearer_than_planned(seed: int) -> None:
    """The distance is that of the tool to the body."""
    hands = np.random.default_rng(seed)
    async with open_bench() as bench:
        alice = await guided(bench, placed=bool(seed % 2))
        nearest = body_distance(bench, bench.cell.posture()) if seed % 2 else 0.0
        await alice.engage()
        async with alice.sending():
            for _ in range(30):
                x, y, z, rx, ry, rz = (hands.normal(size=6) * (0.05, 0.05, 0.05, 0.5, 0.5, 0.5)).tolist()
                alice.twist = (x, y, z - 0.02, rx, ry, rz)
                await bench.clock.sleep(0.5)
                assert alice.status.height is not None
                assert alice.status.height > -0.0005
                assert await bench.true_height() > -0.0015, "as the tracker errs"
                assert body_distance(bench, bench.cell.posture()) > nearest - 0.001
        assert bench.states["teleoperation"] == "engaged"


def body_distance(bench: WorkflowBench, posture: Floats) -> float:
    """Of the tool from the body's hull as it is placed, m; negative inside."""
    model = bench.cell.zones.model
    return float(model.distances(posture)[model.pairs.index((TOOL, BODY))])


async def test_engaging_needs_a_teleoperator_who_sends(alice: Teleoperator) -> None:
    bench = alice.bench
    await bench.refuse("teleoperation.engage", "no_teleoperator")
    before = await tool(bench)
    await alice.engage()
    await held(bench)
    assert danger(bench).code == "teleoperator_lost"
    assert await still(bench, before)


async def test_a_hidden_body_or_a_lost_registration_ends_it(alice: Teleoperator) -> None:
    bench = alice.bench
    await bench.scene.occlude("body_ref", True)
    await bench.clock.sleep(0.5)
    assert (await alice.ask("teleoperation.engage")).decision == "rejected"
    await bench.scene.occlude("body_ref", False)
    await bench.clock.sleep(0.5)
    await alice.engage()
    async with alice.sending():
        alice.twist = UP
        await bench.clock.sleep(0.3)
        await bench.scene.occlude("body_ref", True)
        await held(bench)
    assert danger(bench).code == "pose_stale"


async def test_guiding_ends_with_the_registration_it_rests_on(alice: Teleoperator) -> None:
    bench = alice.bench
    await alice.engage()
    async with alice.sending():
        alice.twist = UP
        await bench.clock.sleep(0.3)
        await bench.accept("registration.clear_registration")
        assert (bench.states["placement"], bench.states["teleoperation"]) == ("held", "off")
        await bench.until(lambda: bench.speed() < 1e-3)
    assert not bench.dispatcher.snapshot().latched


@pytest.mark.parametrize("workflow", ["ratms", "grid_mapping", "ratms_threshold", "femoroplasty"])
def test_planner_role_moves_nothing(workflow: str) -> None:
    branches = read_workflow(workflow).branches
    for name, branch in branches.items():
        for key, operation in branch.operations.items():
            asked = not (operation.event or operation.iio)
            if asked and (operation.blocked_when_latched or name == "placement" or f"{name}.{key}" == "robot.connect"):
                assert set(operation.roles) == {"operator", "teleoperator"}, f"{name}.{key}"
            if name in ("registration", "digitization", "toolplan"):
                assert not operation.roles, f"{name}.{key}"
    assert branches["robot"].operations["acknowledge"].roles == ["operator"], "a decision of the people on site"


async def test_tool_led_along_the_edge_of_its_range_does_not_leave_it() -> None:
    """Aside, at the edge, is outwards: by so little that no bound of the speed notices, and more with each step."""
    async with open_bench({"teleoperation": {"range": 0.101}}) as bench:
        await guided(bench)
        settings, cell = bench.cell.settings.teleoperation, bench.cell
        graph = cell.frames(bench.data)
        guide = GuidedTool(cell, graph.get(Frame.ROBOT_BASE, Frame.REFERENCE) @ planned_in_body_ref(cell, bench.data))

        def lead(twist: Twist, steps: int) -> float:
            """Return how far the tool is from its planned place at the end, m."""
            for _ in range(steps):
                guide.advance(np.array(twist), 1.0, settings.period)
            return float(np.linalg.norm(guide.plan_from_tool.translation))

        assert lead(AWAY, 300) == pytest.approx(settings.range, abs=1e-6)
        before = guide.plan_from_tool
        assert lead((0.02, 0.0, 0.0, 0.0, 0.0, 0.0), 300) <= settings.range + 1e-6
        assert guide.limit == "range"
        assert lead((0.02, 0.0, -0.01, 0.0, 0.0, 0.0), 100) < settings.range
        assert distance(before, guide.plan_from_tool) > 0.01, "where it leads inwards, it goes"


async def test_nothing_moves_while_the_clutch_is_open(alice: Teleoperator) -> None:
    bench = alice.bench
    guiding = GuidanceSession(activity(bench, bench.data))
    for _ in range(2):
        with pytest.raises(RefusalError, match="engage it first") as refused:
            guiding.advance(bench.clock.monotonic(), SETTINGS.period)
        assert refused.value.refusal_code == "not_engaged"
        guiding.engage("alice")
        assert not guiding.advance(bench.clock.monotonic(), SETTINGS.period).any(), "no set point has come"
        guiding.release()


@pytest.mark.parametrize("missing", ["registered", "plan"])
async def test_no_tool_is_guided_without_a_registration_and_a_plan(alice: Teleoperator, missing: str) -> None:
    """A blueprint may let it be guided: from a place that means nothing it is not."""
    data = msgspec.structs.replace(alice.bench.data, **{missing: None})
    with pytest.raises(RefusalError, match="needed to guide") as refused:
        GuidanceSession(activity(alice.bench, data))
    assert refused.value.refusal_code == "not_registered"


def activity(bench: WorkflowBench, data: PlacementData) -> Activity:
    """Return what is handed to the function of the activity in ``guided``, for a procedure with such data."""

    def submit(command: Command) -> NoReturn:
        raise AssertionError(f"It has posted {command.operation}.")

    return Activity(
        name="teleoperate",
        branch="placement",
        state="guided",
        command=bench.run("placement.guide").command,
        cell=bench.cell,
        clock=bench.clock,
        _data=lambda: data,
        _states=lambda: bench.states,
        _submit=submit,
        _show=lambda: None,
    )
