"""A cell acts on what detectors see: it stops, bars motion, calls operations, and never moves by itself."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, ClassVar, cast

import pytest

from pcmrs.dispatcher.procedure import Procedure
from pcmrs.errors import ConfigurationError
from pcmrs.messages import DeviceEvent, Reason, Verdict
from pcmrs.scene.settings import SceneEventSettings, SceneSourceSettings
from pcmrs.service.watches.scene import HELD_UP, SceneWatch
from pcmrs.testing.clock import ManualClock
from pcmrs.testing.detector import ScriptedDetector
from pcmrs.testing.driving import landmarks, tool_pose
from pcmrs.testing.simulated import CellInSimulatedTime, run_simulated
from tests.support.shipped import shipped_workflow

CAMERA = "scene_events.sources.camera={user='tester'}"
HAND = "{label='hand', calls='stop'}"
Course = Callable[[CellInSimulatedTime, ScriptedDetector], Any]


def cell_with(course: Course, *rules: str, source: str = CAMERA, workflow: str = "ratms") -> None:
    """Run a course in a cell with a detector."""

    async def run(cell: CellInSimulatedTime) -> None:
        async with detecting(cell) as detector:
            await course(cell, detector)

    overrides = ("sim.arm.physics=kinematic", source, f"scene_events.rules=[{', '.join(rules)}]")
    run_simulated(run, workflow, overrides=overrides)


@asynccontextmanager
async def detecting(cell: CellInSimulatedTime) -> AsyncIterator[ScriptedDetector]:
    detector = cell.detector()
    task = asyncio.get_running_loop().create_task(detector.run())
    yield detector
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def prepare(cell: CellInSimulatedTime) -> None:
    """Everything but the approach."""
    await cell.accept("robot.connect")
    await cell.until(lambda shown: shown.branches["placement"] != "unknown" and not shown.running)
    await cell.accept("registration.plan_landmarks", **landmarks())
    await cell.accept("digitization.digitize_all")
    await cell.accept("registration.register")
    await cell.accept("toolplan.plan", **tool_pose())


async def approach(cell: CellInSimulatedTime, after: float = 1.0) -> asyncio.Task[Verdict]:
    """An approach that has run for some time."""
    task = asyncio.get_running_loop().create_task(cell.call("placement.approach"))
    await cell.until(lambda shown: bool(shown.running))
    await cell.clock.sleep(after)
    return task


async def acknowledge(cell: CellInSimulatedTime) -> None:
    await cell.until(lambda shown: shown.latched and not shown.stop.pending)
    await cell.accept("robot.acknowledge")


async def reason_of_approach(cell: CellInSimulatedTime) -> str:
    verdict = await cell.call("placement.approach")
    return verdict.reason.code if verdict.reason is not None else verdict.decision


def test_hand_stops_an_approach_and_when_it_has_left_it_goes_on() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await prepare(cell)
        moving = await approach(cell)
        detector.sees["hand"] = {"confidence": 0.9, "region": "table", "track": 7}
        verdict = await moving
        assert verdict.reason is not None
        assert verdict.reason.code == "scene_intrusion"
        assert verdict.reason.fields["track"] == 7
        await acknowledge(cell)
        assert cell.snapshot.branches["placement"] == "held"
        await cell.accept("placement.back_off")
        assert await reason_of_approach(cell) == "scene_not_clear"
        detector.sees.clear()
        await cell.clock.sleep(1.0)
        await cell.accept("placement.home")
        await cell.accept("placement.approach")

    cell_with(course, HAND)


def test_hand_that_stays_lets_only_a_retreat_begin() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await prepare(cell)
        await approach(cell)
        detector.sees["hand"] = {}
        await acknowledge(cell)
        number = cell.snapshot.stop.number
        await cell.accept("placement.back_off")
        assert cell.snapshot.stop.number == number, "nobody may be kept from leaving the patient"

    cell_with(course, HAND)


def test_new_hand_stops_a_retreat_too() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await prepare(cell)
        await cell.accept("placement.approach")
        moving = asyncio.get_running_loop().create_task(cell.call("placement.home"))
        await cell.until(lambda shown: bool(shown.running))
        await cell.clock.sleep(1.0)
        detector.sees["hand"] = {}
        verdict = await moving
        assert verdict.reason is not None
        assert verdict.reason.code == "scene_intrusion"

    cell_with(course, HAND)


def test_second_hand_stops_a_retreat_beside_the_first() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await prepare(cell)
        await approach(cell)
        detector.sees["hand"] = {"track": 1}
        await acknowledge(cell)
        await cell.accept("placement.back_off")
        moving = asyncio.get_running_loop().create_task(cell.call("placement.home"))
        await cell.until(lambda shown: bool(shown.running))
        await cell.clock.sleep(0.5)
        assert not cell.snapshot.latched, "the first was there when the retreat began"
        detector.sees["hand"] = {"track": 2}
        verdict = await moving
        assert verdict.reason is not None
        assert verdict.reason.code == "scene_intrusion"
        assert verdict.reason.fields["track"] == 2

    cell_with(course, HAND)


def test_another_object_calls_an_operation_only_once() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        detector.sees["drift"] = {"track": 1}
        await cell.clock.sleep(1.0)
        sequence = cell.snapshot.sequence
        for number in range(2, 20):
            detector.sees["drift"] = {"track": number}
            await cell.clock.sleep(0.1)
        assert cell.snapshot.sequence == sequence

    cell_with(course, "{label='drift', calls='registration.reference_moved'}")


def test_hand_where_nothing_may_move_is_reported_only() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        detector.sees["hand"] = {}
        await cell.clock.sleep(2.0)
        assert not cell.snapshot.latched
        detector.sees.clear()
        await cell.clock.sleep(1.0)
        await prepare(cell)
        await cell.accept("placement.approach")

    cell_with(course, HAND)


def test_states_of_a_rule_limit_where_it_stops() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await prepare(cell)
        detector.sees["hand"] = {}
        await cell.clock.sleep(1.0)
        assert not cell.snapshot.latched
        detector.sees.clear()
        await cell.clock.sleep(1.0)
        await approach(cell)
        detector.sees["hand"] = {}
        await cell.until(lambda shown: shown.latched)

    cell_with(course, "{label='hand', states={placement=['standoff', 'placed']}}")


def silent(detector: ScriptedDetector) -> None:
    detector.silent = True


def frozen(detector: ScriptedDetector) -> None:
    detector.frozen = True


def flooding(detector: ScriptedDetector) -> None:
    detector.repeats = 500


def occluded(detector: ScriptedDetector) -> None:
    detector.blind = "occluded"


@pytest.mark.parametrize(
    ("harm", "why"), [(silent, "silent"), (frozen, "stale"), (flooding, "flooded"), (occluded, "blind")],
    ids=["silent", "frozen", "flooding", "occluded"],
)  # fmt: skip
def test_lost_source_stops_and_bars_until_it_has_returned(harm: Callable[[ScriptedDetector], None], why: str) -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await prepare(cell)
        moving = await approach(cell)
        harm(detector)
        verdict = await moving
        assert verdict.reason is not None
        assert (verdict.reason.code, verdict.reason.fields["why"]) == ("scene_lost", why)
        await acknowledge(cell)
        await cell.accept("placement.back_off")
        assert await reason_of_approach(cell) == "scene_not_clear"
        detector.silent = detector.frozen = False
        detector.repeats, detector.blind = 1, ""
        await cell.clock.sleep(3.0)
        await cell.accept("placement.home")
        await cell.accept("placement.approach")

    cell_with(course, HAND)


def test_nothing_approaches_before_the_source_has_sent() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        detector.silent = True
        await cell.clock.sleep(1.0)  # where nothing may move, the loss is no danger
        await prepare(cell)
        assert await reason_of_approach(cell) == "scene_not_clear"

    cell_with(course, HAND)


def test_loss_that_is_reported_only_stops_nothing() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await prepare(cell)
        moving = await approach(cell)
        detector.silent = True
        assert (await moving).decision == "accepted"

    cell_with(course, HAND, source="scene_events.sources.camera={user='tester', when_lost='report'}")


def test_label_calls_an_event_operation_once() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await cell.accept("robot.connect")
        await cell.until(lambda shown: not shown.running and shown.branches["placement"] != "unknown")
        detector.sees["cable_out"] = {}
        await cell.until(lambda shown: shown.branches["robot"] == "0")
        sequence = cell.snapshot.sequence
        await cell.clock.sleep(2.0)
        assert cell.snapshot.sequence == sequence, "the label is still the one that has been reported"

    cell_with(course, "{label='cable_out', calls='robot.link_lost'}")


def test_loss_of_a_source_calls_its_operation() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await cell.accept("robot.connect")
        await cell.until(lambda shown: not shown.running and shown.branches["placement"] != "unknown")
        detector.silent = True
        await cell.until(lambda shown: shown.branches["robot"] == "0")

    cell_with(course, source="scene_events.sources.camera={user='tester', when_lost='robot.link_lost'}")


def test_operation_that_ends_what_a_motion_requires_stops_it() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await prepare(cell)
        moving = await approach(cell)
        detector.sees["cable_out"] = {}
        began = cell.clock.monotonic()
        await cell.until(lambda shown: shown.latched and shown.branches["robot"] == "0")
        assert cell.clock.monotonic() - began < 1.0, "it does not wait for the motion"
        verdict = await moving
        assert verdict.reason is not None
        assert (verdict.reason.code, verdict.reason.fields["label"]) == ("scene_seen", "cable_out")

    cell_with(course, "{label='cable_out', calls='robot.link_lost'}")


def test_loss_that_ends_what_a_motion_requires_stops_it() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await prepare(cell)
        moving = await approach(cell)
        detector.silent = True
        began = cell.clock.monotonic()
        await cell.until(lambda shown: shown.latched and shown.branches["robot"] == "0")
        assert cell.clock.monotonic() - began < 1.5
        verdict = await moving
        assert verdict.reason is not None
        assert verdict.reason.code == "scene_lost"

    cell_with(course, source="scene_events.sources.camera={user='tester', when_lost='robot.link_lost'}")


def test_operation_that_no_motion_requires_stops_nothing() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await prepare(cell)
        moving = await approach(cell)
        detector.sees["drift"] = {}
        assert (await moving).decision == "accepted"

    cell_with(course, "{label='drift', calls='alignment.outside'}")


class LateClock(ManualClock):
    """A clock of a loop that is held up each time."""

    async def sleep(self, seconds: float) -> None:
        await super().sleep(seconds + 2.0 * HELD_UP)


async def test_silence_is_found_although_the_watch_is_always_late() -> None:
    class Standing:
        """A dispatcher of a cell in which nothing moves."""

        procedure = Procedure(shipped_workflow("ratms"))
        moving, only_retreats = False, True
        barred: Reason | None = None
        reported: ClassVar[list[DeviceEvent]] = []

        def bar_motion(self, reason: Reason | None) -> None:
            self.barred = reason

        def report_later(self, event: DeviceEvent) -> None:
            self.reported.append(event)

    clock, dispatcher = LateClock(), Standing()
    settings = SceneEventSettings({"camera": SceneSourceSettings()})
    watch = asyncio.create_task(SceneWatch(settings, cast(Any, dispatcher), clock).run())
    for _ in range(20):
        await clock.advance(0.1)
    watch.cancel()
    assert [event.code for event in dispatcher.reported] == ["scene_lost"]
    assert dispatcher.barred is not None


def test_another_user_cannot_send_for_a_source() -> None:
    async def run(cell: CellInSimulatedTime) -> None:
        async with detecting(cell) as detector:
            detector.sees["hand"] = {}
            await cell.clock.sleep(1.0)
            await prepare(cell)
            verdict = await cell.call("placement.approach")
            assert verdict.reason is not None
            assert verdict.reason.fields["source"] == "camera", "only cam1 may say that the camera sees"

    overrides = ("sim.arm.physics=kinematic", "scene_events.sources.camera={user='cam1'}")
    run_simulated(run, overrides=overrides)


def test_quiet_scene_stops_nothing() -> None:
    async def course(cell: CellInSimulatedTime, detector: ScriptedDetector) -> None:
        await prepare(cell)
        await cell.accept("placement.approach")
        number = cell.snapshot.stop.number
        await cell.clock.sleep(60.0)
        assert cell.snapshot.stop.number == number

    cell_with(course, HAND)


def test_table_that_the_workflow_cannot_serve_starts_no_cell() -> None:
    with pytest.raises(ConfigurationError, match=r"placement\.approach, which is for people"):
        cell_with(lambda *_: None, "{label='hand', calls='placement.approach'}")
