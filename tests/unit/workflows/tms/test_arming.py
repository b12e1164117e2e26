"""Arming and disarming: only at the body, never after a failure or a Stop, and supervised meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from pcmrs.messages import DeviceEvent
from tests.unit.workflows.stimulation_bench import StimulationBench


async def test_nothing_is_armed_before_the_coil_is_placed(bench: StimulationBench) -> None:
    await bench.allow()
    await bench.refuse("stimulation.arm", "robot_disconnected")
    await bench.bench.to_standoff()
    await bench.refuse("stimulation.arm", "not_placed")
    await bench.refuse("stimulation.fire", "invalid_in_state")
    assert "arm" not in bench.stimulator.calls


async def test_the_interval_also_counts_from_arming_for_the_first_time(bench: StimulationBench) -> None:
    await bench.bench.to_placed()
    await bench.allow()
    await bench.accept("stimulation.arm")
    await bench.bench.until(lambda: bench.states["alignment"] == "1")
    verdict = await bench.refuse("stimulation.fire", "pulse_too_soon")
    assert verdict.reason is not None
    assert verdict.reason.text.startswith("No pulse was given yet, so the interval counts from arming")


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
