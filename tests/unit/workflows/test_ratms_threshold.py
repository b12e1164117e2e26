"""The whole of `ratms_threshold`: a hot-spot is searched for, and a threshold hunted, by pulses that are given."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import numpy as np
import pytest

from pcmrs.errors import RefusalError
from pcmrs.fsm import examine
from pcmrs.messages import PoseMessage, Verdict
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs.workflows import find_workflow
from pcmrs.workflows.data import as_transform
from pcmrs.workflows.motion import pose_result
from pcmrs.workflows.tms.hotspot import place_known, plan_is_of_search, search_pose_reachable
from pcmrs.workflows.tms.threshold import hunted_intensity_allowed, set_hunted_intensity
from pcmrs.workflows.toolplan import ToolPose, pose_of
from pcmrs_sim.muscle.head_subject import draw_subject
from pcmrs_sim.tms.recruitment import Recruitment
from tests.unit.workflows.stimulation_bench import RESPONDING, SILENT, StimulationBench, stimulation
from tests.unit.workflows.workflow_bench import POSES, open_bench

CENTRE = pose_of(ToolPose(tuple(POSES[0]["position"]), tuple(POSES[0]["quat_xyzw"])))
HOTSPOT = CENTRE @ Transform.from_rotvec((0.005, 0.003, 0.0), (0.0, 0.0, 0.0))
MAP = {"rings": 1, "heading_reach_deg": 0.0}
TOOLS = {"stimulation": {"intervals": {"least": 1.1}, "hotspot": MAP}}


@pytest.fixture
async def registered() -> AsyncIterator[StimulationBench]:
    """A registered head, a muscle that answers best at the hot-spot, and an intensity."""
    async with stimulation(TOOLS) as bench:
        await bench.bench.register()
        await bench.allow()
        yield bench


@pytest.fixture
async def armed() -> AsyncIterator[StimulationBench]:
    async with stimulation(TOOLS) as bench:
        await bench.to_armed()
        yield bench


def answer(image_from_coil: Transform) -> float:
    """Peak-to-peak amplitude, V, that falls with the distance from the hot-spot."""
    return 20e-6 + 2e-3 * float(np.exp(-0.5 * (distance(image_from_coil, HOTSPOT) / 0.010) ** 2))


def same(one: PoseMessage, other: PoseMessage) -> bool:
    """But for rounding."""
    first, second = as_transform(one), as_transform(other)
    return distance(first, second) < 1e-9 and rotation_angle(first, second) < 1e-6


def told(verdict: Verdict) -> dict[str, Any]:
    assert verdict.result is not None
    return verdict.result


async def go_to_next(bench: StimulationBench) -> None:
    """Away from the body, to the pose that the search proposes, and armed there."""
    if bench.states["placement"] != "retracted":
        await bench.accept("placement.home")
    await bench.accept("toolplan.aim_hotspot")
    await bench.accept("placement.approach")
    await bench.accept("placement.confirm")
    bench.emg.amplitude = lambda _: answer(as_transform(bench.data.plan))
    await bench.arm()


# -- the hot-spot -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked", "tolerance"), [({"method": "grid"}, 0.005), ({"method": "adaptive", "max_pulses": 20}, 0.006)]
)
@pytest.mark.nightly
async def test_the_hotspot_is_found_by_pulses(
    registered: StimulationBench, asked: dict[str, Any], tolerance: float
) -> None:
    assert told(await registered.accept("hotspot.begin", **asked))["next"]
    pulses = 0
    while registered.states["hotspot"] == "searching":
        await go_to_next(registered)
        pulses += 1
        assert told(await registered.accept("hotspot.pulse"))["pulses"] == pulses
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
    assert told(await armed.accept("hotspot.pulse"))["counted"]
    await armed.accept("placement.home")
    await armed.accept("toolplan.plan", **POSES[4])
    await armed.accept("placement.approach")
    await armed.accept("placement.confirm")
    await armed.arm()
    await armed.refuse("hotspot.pulse", "other_pose_planned")


async def test_a_pulse_that_says_nothing_is_given_again(armed: StimulationBench) -> None:
    begun = told(await armed.accept("hotspot.begin", method="grid"))
    armed.emg.baseline = 30e-6
    verdict = told(await armed.accept("hotspot.pulse"))
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
    assert told(await armed.accept("hotspot.conclude"))["hotspot"]["uncertainty"] > 0.0
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
        assert told(await bench.accept("hotspot.pulse"))["refusal"] == "no_response"
        assert (bench.states["hotspot"], bench.data.search, bench.data.hotspot) == ("none", None, None)


async def test_a_new_registration_ends_a_search(registered: StimulationBench) -> None:
    await registered.accept("hotspot.begin")
    await registered.accept("registration.register")
    assert (registered.states["hotspot"], registered.data.search) == ("none", None)


# -- the threshold --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "off", "most"),
    [("ml", 5.0, 40), pytest.param("relative_frequency", 8.0, 120, marks=pytest.mark.nightly)],
)
async def test_the_threshold_is_found_by_pulses(armed: StimulationBench, method: str, off: float, most: int) -> None:
    muscle, rng = Recruitment(threshold=47.0), np.random.default_rng(5)
    armed.emg.amplitude = lambda intensity: muscle.sample(intensity, rng)
    begun = told(await armed.accept("threshold.begin", method=method))
    asked = [begun["next"]]
    while armed.states["threshold"] == "hunting":
        result = told(await armed.accept("threshold.pulse"))
        assert result["intensity"] == asked[-1]
        asked.append(result.get("next"))
        await armed.rest()
    assert armed.states["threshold"] == "found"
    assert armed.data.threshold.threshold == pytest.approx(47.0, abs=off)
    assert armed.data.given == len(armed.stimulator.fired) <= most
    assert max(intensity for _, intensity, _ in armed.stimulator.fired) <= 70.0
    assert result["estimate"]["threshold"] == armed.data.threshold.threshold


async def test_the_simulated_subject_has_the_threshold_that_is_found() -> None:
    """The simulated stimulator, muscle and electromyograph in place of the stand-ins; at the subject's own hot-spot."""
    async with open_bench({"stimulation": {"intervals": {"least": 1.1}}}, workflow="ratms_threshold") as bench:
        subject = draw_subject("head", seed=1)
        assert subject is not None
        await bench.register()
        await bench.accept("toolplan.plan", **pose_result(subject.image_from_hotspot))
        await bench.accept("placement.approach")
        await bench.accept("placement.confirm")
        await bench.accept("stimulation.set_ceiling", percent=100.0, operator="Dr Hand")
        await bench.accept("stimulation.set_intensity", percent=50.0)
        await bench.accept("stimulation.arm")
        await bench.until(lambda: bench.states["alignment"] == "1")
        await bench.accept("threshold.begin")
        while bench.states["threshold"] == "hunting":
            await bench.clock.sleep(1.2)
            assert told(await bench.accept("threshold.pulse"))["counted"]
        assert bench.states["threshold"] == "found"
        data: Any = bench.data
        assert data.threshold.threshold == pytest.approx(subject.recruitment.threshold, rel=0.1)


async def test_the_hunt_that_is_journalled_is_the_hunt(armed: StimulationBench) -> None:
    """Oracle: the hunt replayed from its own pulses."""
    await armed.accept("threshold.begin")
    for _ in range(4):
        await armed.accept("threshold.pulse")
        await armed.rest()
    hunt = MotorThresholdEstimator.begin(armed.data.hunt.settings)
    for pulse in armed.data.hunt.pulses:
        assert hunt.next_intensity() == pulse.intensity
        hunt = hunt.after(pulse.intensity, pulse.responded, pulse.amplitude)
    assert hunt == armed.data.hunt
    assert [pulse.intensity for pulse in hunt.pulses] == [intensity for _, intensity, _ in armed.stimulator.fired]


async def test_muscle_without_responses_has_no_threshold_below_ceiling(armed: StimulationBench) -> None:
    armed.emg.amplitude = lambda _: SILENT
    await armed.accept("threshold.begin", method="relative_frequency")
    while armed.states["threshold"] == "hunting":
        result = told(await armed.accept("threshold.pulse"))
        await armed.rest()
    assert (armed.states["threshold"], result["refusal"]) == ("none", "above_ceiling")
    assert max(intensity for _, intensity, _ in armed.stimulator.fired) <= 70.0


UNUSABLE: dict[str, Callable[[StimulationBench], None]] = {
    "preactivated": lambda bench: setattr(bench.emg, "baseline", 30e-6),
    "no_marker": lambda bench: setattr(bench.emg, "lost", True),
}


@pytest.mark.parametrize("problem", UNUSABLE)
async def test_a_pulse_that_says_nothing_teaches_no_hunt(armed: StimulationBench, problem: str) -> None:
    await armed.accept("threshold.begin")
    before = armed.data.hunt
    UNUSABLE[problem](armed)
    result = told(await armed.accept("threshold.pulse"))
    assert (result["problem"], result["pulses"], armed.states["threshold"]) == (problem, 0, "hunting")
    assert armed.data.hunt == before
    assert armed.data.given == 1


async def test_a_hunt_stays_below_the_ceiling_of_the_operator(armed: StimulationBench) -> None:
    await armed.accept("stimulation.disarm")
    await armed.accept("stimulation.set_ceiling", percent=5.0, operator="Dr Hand")
    await armed.refuse("threshold.begin", "ceiling_too_low")
    await armed.accept("stimulation.set_ceiling", percent=70.0, operator="Dr Hand")
    await armed.accept("threshold.begin")
    await armed.accept("stimulation.set_ceiling", percent=30.0, operator="Dr Hand")
    await armed.accept("stimulation.set_intensity", percent=30.0)
    await armed.arm()
    await armed.refuse("threshold.pulse", "intensity_over_ceiling")
    assert not armed.stimulator.fired


async def test_threshold_is_not_hunted_before_a_ceiling_is_set() -> None:
    async with stimulation(TOOLS) as bench:
        await bench.bench.register()
        verdict = await bench.refuse("threshold.begin", "no_ceiling")
        assert verdict.reason is not None
        assert "stimulation.set_ceiling" in verdict.reason.text
        await bench.accept("stimulation.set_ceiling", percent=70.0, operator="Dr Hand")
        await bench.accept("threshold.begin")
        assert bench.data.hunt.settings.ceiling == 70.0


async def test_no_intensity_is_set_for_a_hunt_never_started(armed: StimulationBench) -> None:
    """A blueprint may let a pulse of a hunt be asked for at any time: check and step do not."""
    calls = len(armed.stimulator.calls)
    run = armed.bench.run("threshold.pulse")
    with pytest.raises(RefusalError, match=r"send threshold\.begin first") as refused:
        hunted_intensity_allowed(run)
    assert refused.value.refusal_code == "no_hunt"
    with pytest.raises(RefusalError):
        await set_hunted_intensity(run)
    assert "set_intensity" not in armed.stimulator.calls[calls:]


async def test_with_a_dial_no_pulse_is_given_before_it_is_turned() -> None:
    async with stimulation({"stimulation": {"dialled": True, "intervals": {"least": 1.1}}}) as bench:
        await bench.to_armed()
        asked = told(await bench.accept("threshold.begin"))["next"]
        assert asked != 50.0
        await bench.refuse("threshold.pulse", "not_dialled")
        await bench.accept("stimulation.set_intensity", percent=asked)
        await bench.accept("threshold.pulse")
        assert bench.stimulator.fired[-1][1] == asked


async def test_elsewhere_is_another_threshold(armed: StimulationBench) -> None:
    await armed.accept("threshold.begin")
    await armed.accept("toolplan.plan", **POSES[1])
    assert (armed.states["threshold"], armed.data.hunt) == ("none", None)
    await armed.accept("toolplan.clear")
    await armed.refuse("threshold.begin", "no_plan")


async def test_search_and_hunt_exclude_each_other(armed: StimulationBench) -> None:
    await armed.accept("threshold.begin")
    await armed.refuse("hotspot.begin", "hunt_under_way")
    await armed.accept("threshold.abandon")
    await armed.accept("hotspot.begin")
    await armed.refuse("threshold.begin", "search_under_way")


@pytest.mark.parametrize("name", ["hotspot", "threshold"])
async def test_every_way_to_a_pulse_has_all_its_conditions(armed: StimulationBench, name: str) -> None:
    await armed.accept(f"{name}.begin")
    await armed.accept("stimulation.disarm")
    await armed.refuse(f"{name}.pulse", "not_armed")
    await armed.accept("stimulation.arm")
    await armed.rest()
    await armed.accept(f"{name}.pulse")
    await armed.refuse(f"{name}.pulse", "pulse_too_soon")
    await armed.rest()
    armed.bench.cell.emg = None
    await armed.refuse(f"{name}.pulse", "no_emg")
    armed.bench.cell.emg = armed.emg
    await armed.bench.scene.occlude("coil", hidden=True)
    await armed.until(lambda: armed.states["alignment"] == "0")
    await armed.refuse(f"{name}.pulse", "not_aligned")
    assert len(armed.stimulator.fired) == 1


@pytest.mark.parametrize("name", ["hotspot", "threshold"])
async def test_unknown_pulse_of_a_search_disarms_and_is_not_counted(armed: StimulationBench, name: str) -> None:
    await armed.accept(f"{name}.begin")
    armed.stimulator.mute.add("fire")
    assert (await armed.do(f"{name}.pulse")).decision == "unknown"
    await armed.until(lambda: armed.states["stimulation"] == "disarmed")
    assert len(armed.stimulator.fired) == 1
    kept = armed.data.search if name == "hotspot" else armed.data.hunt
    assert kept.pulses == ()
    armed.stimulator.mute.clear()
    await armed.accept("stimulation.arm")
    await armed.refuse(f"{name}.pulse", "pulse_too_soon")
    await armed.rest()
    await armed.accept(f"{name}.pulse")
    assert [number for number, _, _ in armed.stimulator.fired] == [1, 2]
    assert armed.data.given == 2


async def test_two_pulses_at_once_are_one(armed: StimulationBench) -> None:
    await armed.accept("threshold.begin")
    verdicts = await asyncio.gather(armed.do("threshold.pulse"), armed.do("stimulation.fire"))
    assert [verdict.decision for verdict in verdicts].count("accepted") == 1
    assert len(armed.stimulator.fired) == 1


# -- what the verifier proves ---------------------------------------------------------------------------------

BLUEPRINT = find_workflow("ratms_threshold").blueprint
WEAKER = {
    "pulse_only_armed_and_aligned": (
        '[branches.threshold.operations.pulse.requires]\nstimulation = ["armed"]\nalignment = ["1"]\n',
        '[branches.threshold.operations.pulse.requires]\nstimulation = ["armed"]\n',
        '[branches.threshold.operations.pulse.refusal]\nstimulation = "not_armed"\nalignment = "not_aligned"\n',
        '[branches.threshold.operations.pulse.refusal]\nstimulation = "not_armed"\n',
    ),
    "armed_only_at_the_body": (
        'by = ["registration", "toolplan", "placement"]\nfrom = ["armed"]',
        'by = ["registration", "toolplan"]\nfrom = ["armed"]',
    ),
    "no_ceiling_while_armed": (
        'from = ["disarmed"]\nto = "disarmed"\nroles = ["operator", "teleoperator"]\npayload = "ceiling"',
        'from = ["*"]\nto = { disarmed = "disarmed", armed = "armed" }\npayload = "ceiling"',
    ),
    "disarm_always_accepted": (
        'from = ["*"]\nto = "disarmed"\nchecks = ["stimulator_there"]',
        'from = ["*"]\nto = "disarmed"\nrequires = { alignment = ["1"] }\nchecks = ["stimulator_there"]',
    ),
    "threshold_only_of_this_place": (
        'by = ["registration", "toolplan"]\nfrom = ["hunting", "found"]',
        'by = ["registration"]\nfrom = ["hunting", "found"]',
    ),
}


@pytest.mark.parametrize("promise", WEAKER)
@pytest.mark.nightly
def test_the_verifier_notices_a_weaker_rule(promise: str) -> None:
    text = BLUEPRINT.read_text()
    changes = WEAKER[promise]
    for old, new in zip(changes[::2], changes[1::2], strict=True):
        assert text.count(old) == 1
        text = text.replace(old, new)
    findings = examine(text.encode(), folder=BLUEPRINT.parent).findings
    assert promise in " ".join(finding.text for finding in findings if finding.code == "property_violated")
