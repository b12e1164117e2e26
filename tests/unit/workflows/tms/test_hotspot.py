"""A hot-spot is searched for by pulses that are given."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import numpy as np
import pytest

from pcmrs.errors import RefusalError
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs.workflows.data import as_transform
from pcmrs.workflows.tms.hotspot import place_known, plan_is_of_search, search_pose_reachable
from pcmrs.workflows.toolplan import ToolPose, pose_of
from tests.unit.workflows.stimulation_bench import RESPONDING, SILENT, StimulationBench, result_of, stimulation
from tests.unit.workflows.workflow_bench import POSES

CENTRE = pose_of(ToolPose(tuple(POSES[0]["position"]), tuple(POSES[0]["quat_xyzw"])))
HOTSPOT = CENTRE @ Transform.from_rotvec((0.005, 0.003, 0.0), (0.0, 0.0, 0.0))


@pytest.fixture
async def registered() -> AsyncIterator[StimulationBench]:
    """A registered head, a muscle that answers best at the hot-spot, and an intensity."""
    async with stimulation() as bench:
        await bench.bench.register()
        await bench.allow()
        yield bench


def answer(image_from_coil: Transform) -> float:
    """Peak-to-peak amplitude, V, that falls with the distance from the hot-spot."""
    return 20e-6 + 2e-3 * float(np.exp(-0.5 * (distance(image_from_coil, HOTSPOT) / 0.010) ** 2))


def same(one: PoseMessage, other: PoseMessage) -> bool:
    """But for rounding."""
    first, second = as_transform(one), as_transform(other)
    return distance(first, second) < 1e-9 and rotation_angle(first, second) < 1e-6


async def go_to_next(bench: StimulationBench) -> None:
    """Away from the body, to the pose that the search proposes, and armed there."""
    if bench.states["placement"] != "retracted":
        await bench.accept("placement.home")
    await bench.accept("toolplan.aim_hotspot")
    await bench.accept("placement.approach")
    await bench.accept("placement.confirm")
    bench.emg.amplitude = lambda _: answer(as_transform(bench.data.plan))
    await bench.arm()


@pytest.mark.parametrize(
    ("asked", "tolerance"), [({"method": "grid"}, 0.005), ({"method": "adaptive", "max_pulses": 20}, 0.006)]
)
@pytest.mark.nightly
async def test_the_hotspot_is_found_by_pulses(
    registered: StimulationBench, asked: dict[str, Any], tolerance: float
) -> None:
    assert result_of(await registered.accept("hotspot.begin", **asked))["next"]
    pulses = 0
    while registered.states["hotspot"] == "searching":
        await go_to_next(registered)
        pulses += 1
        assert result_of(await registered.accept("hotspot.pulse"))["pulses"] == pulses
    assert registered.states["hotspot"] == "found"
    assert registered.data.given == pulses == len(registered.data.search.pulses)
    assert distance(as_transform(registered.data.hotspot), HOTSPOT) < tolerance
    await registered.accept("placement.home")
    await registered.accept("toolplan.aim_hotspot")
    assert same(registered.data.plan, registered.data.hotspot)


async def test_search_needs_registration_intensity_and_surface(registered: StimulationBench) -> None:
    await registered.refuse("hotspot.begin", "bad_arguments", method="by feeling")
    await registered.refuse("hotspot.begin", "bad_arguments", rings=100)
    over = {"position": [9.0, 0.0, 0.0], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]}
    await registered.refuse("hotspot.begin", "wrong_unit", centre=over)
    await registered.refuse("toolplan.aim_hotspot", "no_search")
    await registered.accept("registration.clear_registration")
    await registered.refuse("hotspot.begin", "not_registered")
    async with stimulation({"body": {"surface": ""}}) as bare:
        await bare.bench.register()
        await bare.refuse("hotspot.begin", "no_intensity")
        await bare.allow()
        await bare.refuse("hotspot.begin", "no_surface")


async def test_a_search_around_the_plan_needs_a_plan(registered: StimulationBench) -> None:
    await registered.accept("toolplan.clear")
    verdict = await registered.refuse("hotspot.begin", "no_plan")
    assert verdict.reason is not None
    assert "plan one first" in verdict.reason.text
    await registered.accept("hotspot.begin", centre=POSES[0])


async def test_no_pose_is_taken_for_that_of_a_search_never_started(registered: StimulationBench) -> None:
    """A blueprint may let a pulse of a search be asked for at any time: the checks do not."""
    for check in (plan_is_of_search, search_pose_reachable, place_known):
        with pytest.raises(RefusalError, match=r"send hotspot\.begin first") as refused:
            check(registered.bench.run("hotspot.pulse"))
        assert refused.value.refusal_code == "no_search"
    await registered.accept("hotspot.begin")
    plan_is_of_search(registered.bench.run("hotspot.pulse"))


async def test_search_pulses_need_the_proposed_pose_and_one_intensity(armed: StimulationBench) -> None:
    await armed.accept("hotspot.begin", method="grid")
    await armed.accept("stimulation.set_intensity", percent=55.0)
    await armed.refuse("hotspot.pulse", "intensity_changed")
    await armed.accept("stimulation.set_intensity", percent=50.0)
    assert result_of(await armed.accept("hotspot.pulse"))["counted"]
    await armed.accept("placement.home")
    await armed.accept("toolplan.plan", **POSES[4])
    await armed.accept("placement.approach")
    await armed.accept("placement.confirm")
    await armed.arm()
    await armed.refuse("hotspot.pulse", "other_pose_planned")


async def test_a_pulse_that_says_nothing_is_given_again(armed: StimulationBench) -> None:
    begun = result_of(await armed.accept("hotspot.begin", method="grid"))
    armed.emg.baseline = 30e-6
    verdict = result_of(await armed.accept("hotspot.pulse"))
    assert (verdict["counted"], verdict["problem"], verdict["pulses"]) == (False, "preactivated", 0)
    assert armed.data.search.pulses == ()
    assert begun["next"]["position"] == armed.data.search.next().position
    assert armed.data.given == 1


async def test_a_search_can_be_concluded_once_something_has_answered(armed: StimulationBench) -> None:
    await armed.accept("hotspot.begin")
    await armed.refuse("hotspot.conclude", "no_response")
    armed.emg.amplitude = lambda _: SILENT
    await armed.accept("hotspot.pulse")
    await armed.refuse("hotspot.conclude", "no_response")
    armed.emg.amplitude = lambda _: RESPONDING
    await armed.rest()
    await armed.accept("hotspot.pulse")
    assert result_of(await armed.accept("hotspot.conclude"))["hotspot"]["uncertainty"] > 0.0
    assert armed.states["hotspot"] == "found"


async def test_a_search_that_nothing_answers_ends_without_a_hotspot() -> None:
    """S14: no MEP; the result says so."""
    few = {"stimulation": {"intervals": {"least": 1.1}, "hotspot": {"min_pulses": 1, "max_pulses": 2}}}
    async with stimulation(few) as bench:
        await bench.to_armed()
        bench.emg.amplitude = lambda _: SILENT
        await bench.accept("hotspot.begin")
        await bench.accept("hotspot.pulse")
        await bench.rest()
        proposed = bench.data.search.next()
        await bench.accept("placement.home")
        await bench.accept("toolplan.aim_hotspot")
        assert same(bench.data.plan, proposed)
        await bench.accept("placement.approach")
        await bench.accept("placement.confirm")
        await bench.arm()
        assert result_of(await bench.accept("hotspot.pulse"))["refusal"] == "no_response"
        assert (bench.states["hotspot"], bench.data.search, bench.data.hotspot) == ("none", None, None)


async def test_a_new_registration_ends_a_search(registered: StimulationBench) -> None:
    await registered.accept("hotspot.begin")
    await registered.accept("registration.register")
    assert (registered.states["hotspot"], registered.data.search) == ("none", None)
