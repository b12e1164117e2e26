"""A pulse is given only armed, at its place, not too soon and never twice; and its response is measured."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pcmrs.errors import DeviceError
from pcmrs.messages import Command, HeadMotion
from pcmrs.spatial import distance
from pcmrs.workflows.data import as_transform
from tests.unit.workflows.stimulation_bench import RESPONDING, SILENT, StimulationBench, stimulation


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


async def test_pulses_keep_their_interval(armed: StimulationBench) -> None:
    await armed.accept("stimulation.fire")
    verdict = await armed.refuse("stimulation.fire", "pulse_too_soon")
    assert verdict.reason is not None
    await armed.clock.sleep(verdict.reason.fields["wait"] + 1e-6)
    await armed.accept("stimulation.fire")
    (_, _, first), (_, _, second) = armed.stimulator.fired
    assert second - first >= 1.1


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


async def test_pulses_given_elsewhere_are_detected(armed: StimulationBench) -> None:
    armed.stimulator.arming.pulse = 7
    await armed.refuse("stimulation.fire", "pulse_unaccounted", "failed")
    await armed.accept("stimulation.disarm")
    await armed.arm()
    await armed.accept("stimulation.fire")
    assert armed.stimulator.fired[-1][0] == 8
    assert armed.data.given == 8


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


async def test_pulses_are_given_while_the_coil_follows_the_head(bench: StimulationBench) -> None:
    await bench.bench.to_placed()
    await bench.allow()
    await bench.accept("placement.follow")
    await bench.bench.scene.set_motion(
        HeadMotion(breathing_amplitude=0.001, breathing_hz=0.25, breathing_direction=(0.0, 0.0, 1.0))
    )
    await bench.arm()
    await bench.accept("stimulation.fire")
