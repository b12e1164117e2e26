"""Pulses: given only armed, at their place, within the ceiling, not too soon; never twice; and Stop disarms."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import msgspec
import pytest

from pcmrs.errors import DeviceError, RefusalError
from pcmrs.messages import Command, DeviceEvent, HeadBurst, HeadMotion
from pcmrs.spatial import distance
from pcmrs.workflows import read_workflow
from pcmrs.workflows.alignment import BODIES
from pcmrs.workflows.data import as_transform
from pcmrs.workflows.settings import ProcedureSettings
from pcmrs.workflows.tms.coil_alignment import coil_on_target
from tests.unit.workflows.stimulation_bench import RESPONDING, SILENT, StimulationBench, stimulation


@pytest.fixture
async def bench() -> AsyncIterator[StimulationBench]:
    """Connected, with nothing registered."""
    async with stimulation() as opened:
        yield opened


@pytest.fixture
async def armed() -> AsyncIterator[StimulationBench]:
    """Placed, aligned, armed at 50 % below a ceiling of 70 %."""
    async with stimulation() as opened:
        await opened.to_armed()
        yield opened


def events(bench: StimulationBench) -> list[str]:
    return [each.code for each in bench.bench.published if isinstance(each, DeviceEvent)]


# -- a pulse ----------------------------------------------------------------------------------------------


async def test_pulse_is_given_once_and_its_response_reported(armed: StimulationBench) -> None:
    verdict = await armed.accept("stimulation.fire")
    assert [pulse[:2] for pulse in armed.stimulator.fired] == [(1, 50.0)]
    result = verdict.result or {}
    assert (result["pulse"], result["intensity"], result["counted"]) == (1, 50.0, True)
    assert result["mep"]["present"]
    assert result["mep"]["peak_to_peak"] == pytest.approx(RESPONDING, rel=0.1)
    assert result["error_mm"] < 1.5
    assert armed.data.response.pulse == armed.data.epoch.pulse == armed.data.pulse == armed.data.given == 1
    assert armed.states["stimulation"] == "armed"


async def test_the_coil_is_on_record_as_the_tracker_saw_it(armed: StimulationBench) -> None:
    await armed.accept("stimulation.fire")
    plan, coil = as_transform(armed.data.plan), as_transform(armed.data.response.coil)
    assert distance(plan, coil) * 1000.0 == pytest.approx(armed.data.response.error_mm, abs=1e-6)


async def test_the_intent_is_on_record_before_the_pulse(armed: StimulationBench) -> None:
    rows = armed.bench.recorder.rows
    before = len(rows)
    await armed.accept("stimulation.fire")
    assert rows[before:] == [("intent", "fire"), ("outcome", "fire")]


async def test_a_repeated_command_fires_nothing(armed: StimulationBench) -> None:
    command = Command(id="once", branch="stimulation", operation="fire", source="test:user", arguments={})
    verdict = await armed.bench.dispatcher.submit(command)
    await armed.rest()
    assert await armed.bench.dispatcher.submit(command) == verdict
    assert len(armed.stimulator.fired) == 1


async def test_missing_stimulator_is_refused_with_the_setting_to_set(bench: StimulationBench) -> None:
    bench.bench.cell.stimulator = None
    await bench.accept("stimulation.set_ceiling", percent=70.0, operator="Dr Hand")
    verdict = await bench.refuse("stimulation.set_intensity", "no_stimulator", percent=50.0)
    assert verdict.reason is not None
    assert "stimulator.driver" in verdict.reason.text


async def test_pulse_without_an_electromyograph_is_given_uncounted(armed: StimulationBench) -> None:
    armed.bench.cell.emg = None
    verdict = await armed.accept("stimulation.fire")
    assert verdict.result is not None
    assert (verdict.result["counted"], verdict.result["problem"], verdict.result["mep"]) == (False, "no_emg", None)
    assert armed.data.given == 1


UNUSABLE: dict[str, tuple[str, Any]] = {
    "preactivated": ("baseline", 30e-6),
    "artefact": ("artefact", 200e-6),
    "saturated": ("full_scale", 100e-6),
    "no_marker": ("lost", True),
}


@pytest.mark.parametrize("problem", UNUSABLE)
async def test_unusable_response_is_reported_with_its_problem(armed: StimulationBench, problem: str) -> None:
    setattr(armed.emg, *UNUSABLE[problem])
    verdict = await armed.accept("stimulation.fire")
    assert verdict.result is not None
    assert (verdict.result["counted"], verdict.result["problem"]) == (False, problem)
    assert verdict.result["problem_text"]
    assert armed.data.given == 1, "it was given"


async def test_no_response_is_one(armed: StimulationBench) -> None:
    armed.emg.amplitude = lambda _: SILENT
    verdict = await armed.accept("stimulation.fire")
    assert verdict.result is not None
    assert (verdict.result["counted"], verdict.result["mep"]["present"]) == (True, False)


# -- what keeps a pulse from being given ------------------------------------------------------------------------


async def test_nothing_is_armed_before_the_coil_is_placed(bench: StimulationBench) -> None:
    await bench.allow()
    await bench.refuse("stimulation.arm", "robot_disconnected")
    await bench.bench.to_standoff()
    await bench.refuse("stimulation.arm", "not_placed")
    await bench.refuse("stimulation.fire", "invalid_in_state")
    assert "arm" not in bench.stimulator.calls


async def test_intensity_needs_a_ceiling_and_stays_below(bench: StimulationBench) -> None:
    await bench.refuse("stimulation.set_intensity", "no_ceiling", percent=10.0)
    await bench.bench.to_placed()
    await bench.refuse("stimulation.arm", "no_intensity")
    await bench.accept("stimulation.set_ceiling", percent=60.0, operator="Dr Hand")
    verdict = await bench.refuse("stimulation.set_intensity", "intensity_over_ceiling", percent=60.5)
    assert verdict.reason is not None
    assert "Dr Hand" in verdict.reason.text
    await bench.accept("stimulation.set_intensity", percent=60.0)
    await bench.accept("stimulation.set_ceiling", percent=40.0, operator="Dr Hand")
    await bench.refuse("stimulation.arm", "intensity_over_ceiling")
    assert bench.data.ceiling.percent == 40.0


async def test_invalid_ceiling_is_refused(bench: StimulationBench) -> None:
    wrong: list[dict[str, Any]] = [
        {"percent": 0.0, "operator": "x"},
        {"percent": 100.5, "operator": "x"},
        {"percent": float("nan"), "operator": "x"},
        {"percent": 50.0, "operator": ""},
        {"percent": 50.0, "operator": "a\nb"},
        {"percent": 50.0},
    ]
    for arguments in wrong:
        await bench.refuse("stimulation.set_ceiling", "bad_arguments", **arguments)


async def test_the_ceiling_stays_while_armed(armed: StimulationBench) -> None:
    await armed.refuse("stimulation.set_ceiling", "invalid_in_state", percent=90.0, operator="Dr Hand")


async def test_pulses_keep_their_interval(armed: StimulationBench) -> None:
    await armed.accept("stimulation.fire")
    verdict = await armed.refuse("stimulation.fire", "pulse_too_soon")
    assert verdict.reason is not None
    await armed.clock.sleep(verdict.reason.fields["wait"] + 1e-6)
    await armed.accept("stimulation.fire")
    (_, _, first), (_, _, second) = armed.stimulator.fired
    assert second - first >= 1.1


async def test_the_interval_also_counts_from_arming_for_the_first_time(bench: StimulationBench) -> None:
    await bench.bench.to_placed()
    await bench.allow()
    await bench.accept("stimulation.arm")
    await bench.bench.until(lambda: bench.states["alignment"] == "1")
    await bench.refuse("stimulation.fire", "pulse_too_soon")


async def test_pulses_are_counted_and_limited() -> None:
    async with stimulation({"stimulation": {"intervals": {"least": 1.1, "most_pulses": 2}}}) as bench:
        await bench.to_armed()
        for _ in range(2):
            await bench.accept("stimulation.fire")
            await bench.rest()
        await bench.refuse("stimulation.fire", "too_many_pulses")


async def test_not_aligned_no_pulse(armed: StimulationBench) -> None:
    await armed.bench.scene.occlude("coil", hidden=True)
    await armed.until(lambda: armed.states["alignment"] == "0")
    await armed.refuse("stimulation.fire", "not_aligned")


async def test_misplaced_coil_gives_no_pulse_even_if_still_aligned() -> None:
    """The gate tolerates an error for a while; a pulse does not."""
    async with stimulation({"alignment": {"off_time": 30.0}}) as bench:
        await bench.to_armed()
        await bench.bench.scene.move_body((0.003, 0.0, 0.0))
        await bench.clock.sleep(1.0)
        assert bench.states["alignment"] == "1"
        verdict = await bench.refuse("stimulation.fire", "coil_off_target")
        assert verdict.reason is not None
        assert verdict.reason.fields["error_mm"] == pytest.approx(3.0, abs=0.3)
    assert not bench.stimulator.fired


async def test_body_not_seen_lately_allows_no_pulse() -> None:
    async with stimulation({"alignment": {"off_time": 30.0}}) as bench:
        await bench.to_armed()
        await bench.bench.scene.occlude("body_ref", hidden=True)
        await bench.clock.sleep(0.5)
        assert bench.states["alignment"] == "1"
        await bench.refuse("stimulation.fire", "pose_stale")


async def test_too_few_frames_to_tell_a_speed_give_no_pulse() -> None:
    async with stimulation({"alignment": {"off_time": 30.0}}) as bench:
        await bench.to_armed()
        await bench.bench.scene.occlude("body_ref", hidden=True)
        await bench.clock.sleep(1.0)
        await bench.bench.scene.occlude("body_ref", hidden=False)
        shown = bench.clock.monotonic()
        await bench.until(lambda: bool(bench.bench.cell.poses.together(BODIES, shown)))
        verdict = await bench.refuse("stimulation.fire", "pose_stale")
        assert verdict.reason is not None
        fields = verdict.reason.fields
        assert fields["age"] <= fields["limit"], "they are fresh"
        assert 0 < fields["frames"] < 4
        await bench.clock.sleep(0.1)
        await bench.accept("stimulation.fire")


async def test_a_head_that_moves_fast_gets_no_pulse() -> None:
    """S12: 86 mm/s, with a tolerance that would take the coil for placed."""
    loose = {"stimulation": {"tolerance_mm": 100.0, "intervals": {"least": 1.1}}, "alignment": {"off_time": 30.0}}
    burst = HeadMotion(bursts=[HeadBurst(time=0.1, duration=0.8, speed=0.086, direction=(1.0, 0.0, 0.0))])
    async with stimulation(loose) as bench:
        await bench.to_armed()
        await bench.bench.scene.set_motion(burst)
        await bench.clock.sleep(0.6)
        verdict = await bench.refuse("stimulation.fire", "head_moves")
        assert verdict.reason is not None
        assert verdict.reason.fields["speed"] == pytest.approx(0.086, abs=0.01)
        await bench.clock.sleep(1.0)
        await bench.accept("stimulation.fire")


async def test_changes_while_the_stimulator_charges_are_checked_again() -> None:
    async with stimulation({"alignment": {"off_time": 30.0}}) as bench:
        await bench.to_armed()
        bench.stimulator.ready_at = bench.clock.monotonic() + 1.0
        task = asyncio.create_task(bench.do("stimulation.fire"))
        await bench.clock.sleep(0.2)
        await bench.bench.scene.move_body((0.003, 0.0, 0.0))
        verdict = await task
        assert verdict.reason is not None
        assert (verdict.decision, verdict.reason.code) == ("failed", "coil_off_target")
        assert not bench.stimulator.fired


async def test_a_stimulator_that_is_hot_is_not_waited_for_forever(armed: StimulationBench) -> None:
    armed.stimulator.coil_temperature = 45.0
    verdict = await armed.refuse("stimulation.fire", "stimulator_not_ready", "failed")
    assert verdict.reason is not None
    assert "45 °C" in verdict.reason.text
    assert not armed.stimulator.fired


async def test_turned_dial_is_detected(armed: StimulationBench) -> None:
    armed.stimulator.reports = 65.0
    await armed.refuse("stimulation.fire", "intensity_differs", "failed")
    assert not armed.stimulator.fired


async def test_pulses_given_elsewhere_are_detected(armed: StimulationBench) -> None:
    armed.stimulator.arming.pulse = 7
    await armed.refuse("stimulation.fire", "pulse_unaccounted", "failed")
    await armed.accept("stimulation.disarm")
    await armed.arm()
    await armed.accept("stimulation.fire")
    assert armed.stimulator.fired[-1][0] == 8
    assert armed.data.given == 8


# -- nobody knows whether it fired ------------------------------------------------------------------------------


@pytest.mark.parametrize("carried_out", [True, False])
async def test_a_pulse_of_unknown_outcome_is_never_repeated(armed: StimulationBench, carried_out: bool) -> None:
    (armed.stimulator.mute if carried_out else armed.stimulator.deaf).add("fire")
    verdict = await armed.do("stimulation.fire")
    assert verdict.decision == "unknown"
    assert armed.states["stimulation"] == "disarmed"
    assert not armed.stimulator.arming.armed
    armed.stimulator.mute.clear()
    armed.stimulator.deaf.clear()
    await armed.clock.sleep(10.0)
    assert len(armed.stimulator.fired) == carried_out, "nothing fires by itself"
    await armed.accept("stimulation.arm")
    if carried_out:
        await armed.refuse("stimulation.fire", "pulse_too_soon")
    await armed.rest()
    await armed.accept("stimulation.fire")
    numbers = [number for number, _, _ in armed.stimulator.fired]
    assert numbers == sorted(set(numbers))
    assert armed.data.given == len(numbers)


async def test_a_late_delivery_of_the_same_pulse_fires_nothing(armed: StimulationBench) -> None:
    await armed.accept("stimulation.fire")
    with pytest.raises(DeviceError, match="already"):
        await armed.stimulator.fire(1)


# -- disarming ----------------------------------------------------------------------------------------------


async def test_it_can_be_disarmed_and_a_disarmed_one_gives_no_pulse(armed: StimulationBench) -> None:
    await armed.accept("stimulation.disarm")
    assert not armed.stimulator.arming.armed
    await armed.refuse("stimulation.fire", "invalid_in_state")
    await armed.accept("stimulation.disarm")


async def test_stop_disarms_and_nothing_arms_until_it_is_acknowledged(armed: StimulationBench) -> None:
    assert await armed.bench.dispatcher.stop("test:operator")
    assert not armed.stimulator.arming.armed
    await armed.until(lambda: armed.states["stimulation"] == "disarmed")
    await armed.refuse("stimulation.arm", "latched")
    await armed.accept("robot.acknowledge")
    await armed.refuse("stimulation.fire", "invalid_in_state")
    await armed.accept("stimulation.arm")


async def test_stop_reaches_a_pulse_that_waits_for_the_stimulator(armed: StimulationBench) -> None:
    armed.stimulator.ready_at = armed.clock.monotonic() + 2.0
    task = asyncio.create_task(armed.do("stimulation.fire"))
    await armed.clock.sleep(0.1)
    await armed.bench.dispatcher.stop("test:operator")
    verdict = await task
    assert (verdict.decision, verdict.reason and verdict.reason.code) == ("failed", "stopped")
    await armed.clock.sleep(5.0)
    assert not armed.stimulator.fired


async def test_pulse_given_before_a_stop_counts_after_rearming(armed: StimulationBench) -> None:
    task = asyncio.create_task(armed.do("stimulation.fire"))
    await armed.until(lambda: bool(armed.stimulator.fired))
    await armed.bench.dispatcher.stop("test:operator")
    assert (await task).decision == "failed"
    await armed.until(lambda: armed.states["stimulation"] == "disarmed")
    await armed.accept("robot.acknowledge")
    await armed.accept("stimulation.arm")
    assert (armed.data.pulse, armed.data.given) == (1, 1)
    await armed.refuse("stimulation.fire", "pulse_too_soon")


async def test_stop_while_it_charges_leaves_it_disarmed(bench: StimulationBench) -> None:
    await bench.bench.to_placed()
    await bench.allow()
    task = asyncio.create_task(bench.do("stimulation.arm"))
    await bench.until(lambda: "arm" in bench.stimulator.calls)
    await bench.bench.dispatcher.stop("test:operator")
    assert (await task).decision == "failed"
    assert bench.states["stimulation"] == "disarmed"
    assert not bench.stimulator.arming.armed


async def test_stimulator_that_disarms_by_itself_is_shown_disarmed(armed: StimulationBench) -> None:
    await armed.bench.dispatcher.report(armed.stimulator.arming.expiry())
    assert armed.states["stimulation"] == "disarmed"


async def test_one_that_disarms_without_a_word_is_found_out(armed: StimulationBench) -> None:
    armed.stimulator.arming.disarm()
    await armed.until(lambda: armed.states["stimulation"] == "disarmed")
    assert not armed.bench.dispatcher.snapshot().latched


async def test_one_that_does_not_answer_is_a_danger(armed: StimulationBench) -> None:
    armed.stimulator.deaf.add("state")
    await armed.until(lambda: armed.states["stimulation"] == "disarmed")
    assert armed.bench.dispatcher.snapshot().latched
    assert not armed.stimulator.arming.armed


LEAVING: dict[str, Callable[[StimulationBench], Any]] = {
    "registration": lambda bench: bench.accept("registration.clear_registration"),
    "plan": lambda bench: bench.accept("toolplan.clear"),
    "back off": lambda bench: bench.accept("placement.back_off"),
    "nudge": lambda bench: bench.accept("placement.nudge", translation=[0.001, 0.0, 0.0]),
    "follow": lambda bench: bench.accept("placement.follow"),
    "force": lambda bench: bench.bench.dispatcher.report(
        DeviceEvent(device="robot", code="force_limit", text="Pushed.", danger=True)
    ),
    "link": lambda bench: bench.bench.dispatcher.report(
        DeviceEvent(device="robot", code="link_lost", text="Cut.", danger=True)
    ),
}


@pytest.mark.parametrize("way", LEAVING)
async def test_whatever_moves_the_coil_or_what_it_rests_on_disarms(armed: StimulationBench, way: str) -> None:
    await LEAVING[way](armed)
    await armed.until(lambda: armed.states["stimulation"] == "disarmed")
    await armed.until(lambda: not armed.stimulator.arming.armed)


async def test_pulses_are_given_while_the_coil_follows_the_head(bench: StimulationBench) -> None:
    await bench.bench.to_placed()
    await bench.allow()
    await bench.accept("placement.follow")
    await bench.bench.scene.set_motion(
        HeadMotion(breathing_amplitude=0.001, breathing_hz=0.25, breathing_direction=(0.0, 0.0, 1.0))
    )
    await bench.arm()
    await bench.accept("stimulation.fire")


async def test_a_stimulator_that_does_not_arm_is_refused(bench: StimulationBench) -> None:
    await bench.bench.to_placed()
    await bench.allow()
    bench.stimulator.deaf.add("arm")
    assert (await bench.do("stimulation.arm")).decision == "unknown"
    assert bench.states["stimulation"] == "disarmed"
    assert bench.stimulator.calls[-1] == "disarm"


async def test_stimulator_values_are_shown(armed: StimulationBench) -> None:
    armed.stimulator.coil_temperature = 31.0
    await armed.clock.sleep(0.5)
    (shown,) = [each for each in armed.bench.dispatcher.snapshot().activities if each.name == "watch_stimulator"]
    assert shown.values == {"ready": True, "intensity": 50.0, "coil_temperature": 31.0}


# -- whatever the states say --------------------------------------------------------------------------------


async def test_no_pulse_by_frames_of_before_the_tracker_was_restarted() -> None:
    """They are forgotten; while the coil is hidden no new one shows where it is."""
    async with stimulation({"alignment": {"off_time": 30.0}}) as bench:
        await bench.to_armed()
        await bench.bench.scene.occlude("coil", hidden=True)
        await bench.clock.sleep(0.2)  # what has shown it is on its way for less
        bench.bench.tracker_session = "second"
        await bench.clock.sleep(0.5)
        assert (bench.states["alignment"], bench.states["placement"]) == ("1", "placed")
        verdict = await bench.refuse("stimulation.fire", "pose_stale")
        assert verdict.reason is not None
        assert "have not been seen together" in verdict.reason.text
    assert not bench.stimulator.fired


@pytest.mark.parametrize("missing", ["registered", "plan"])
async def test_no_pulse_without_a_registration_and_a_plan(armed: StimulationBench, missing: str) -> None:
    """A blueprint may forget to require them for its pulses: the check does not."""
    run = armed.bench.run("stimulation.fire")
    coil_on_target(run)
    run.keep(**{missing: None})
    with pytest.raises(RefusalError, match="both are needed for a pulse") as refused:
        coil_on_target(run)
    assert refused.value.refusal_code == "no_plan"


async def test_stimulator_that_did_not_arm_does_not_count_as_armed(
    bench: StimulationBench,
) -> None:
    await bench.bench.to_placed()
    await bench.allow()
    arming = asyncio.create_task(bench.do("stimulation.arm"))
    await bench.until(lambda: bench.stimulator.arming.armed)
    bench.stimulator.arming.disarm()  # as it charges, by itself
    verdict = await arming
    assert verdict.reason is not None
    assert (verdict.decision, verdict.reason.code, verdict.state) == ("failed", "not_armed", "disarmed")
    assert bench.stimulator.calls[-1] == "disarm"
    await bench.arm()
    await bench.accept("stimulation.fire")


# -- the workflow -------------------------------------------------------------------------------------------


def test_epochs_must_hold_what_is_looked_at() -> None:
    with pytest.raises(msgspec.ValidationError, match="epoch_before"):
        msgspec.convert({"stimulation": {"epoch_before": 0.05}}, ProcedureSettings)


def test_the_workflow_extends_ratms() -> None:
    ratms, own = read_workflow("ratms"), read_workflow("ratms_threshold")
    for name, branch in ratms.branches.items():
        if name != "toolplan":
            assert own.branches[name] == branch
    assert set(own.branches) - set(ratms.branches) == {"stimulation", "hotspot", "threshold"}
    assert own.properties[: len(ratms.properties)] == ratms.properties
