"""The witness keeps the first violation, and looks only at the run of the daemon that is there."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from pcmrs.devices.motion.press import Relief
from pcmrs.dispatcher import DispatcherListener
from pcmrs.journal import JournalReader
from pcmrs.spatial import Transform
from pcmrs_lab.campaign.explore.witness import Witness
from tests.unit.lab.blueprints import ratms
from tests.unit.lab.campaign.explore.ratms_views import APPROACH, READY, command, decided, event, joints, shown
from tests.unit.lab.campaign.explore.test_view import Reader


class ScriptedDispatcher:
    """A dispatcher in its first state, which publishes to its listeners."""

    def __init__(self) -> None:
        self.listeners: list[DispatcherListener] = []

    def add_listener(self, listener: DispatcherListener) -> None:
        self.listeners.append(listener)

    def snapshot(self) -> Any:
        return shown()

    def publish(self, message: Any) -> None:
        for listener in self.listeners:
            listener.on_publish(message)


@pytest.fixture
async def witness() -> Witness:
    return Witness(ratms())


def observed(witness: Witness) -> tuple[ScriptedDispatcher, Reader]:
    dispatcher, reader = ScriptedDispatcher(), Reader()
    witness.observe(cast(Any, dispatcher), cast(JournalReader, reader))
    return dispatcher, reader


async def test_the_first_violation_counts(witness: Witness) -> None:
    witness.break_("stop_holds", "The arm moves.")
    witness.break_("performed_once", "It was performed twice.")
    assert witness.violation is not None
    assert (witness.violation.invariant, witness.violation.text) == ("stop_holds", "The arm moves.")
    assert witness.violated.is_set()


async def test_every_message_of_the_run_is_judged(witness: Witness) -> None:
    dispatcher, _ = observed(witness)
    assert witness.violation is None
    dispatcher.publish(event("link_lost"))
    dispatcher.publish(shown(2))
    assert witness.violation is None
    dispatcher.publish(decided(id="1"))
    assert witness.violation is not None
    assert witness.violation.invariant == "durable_before_known"
    assert witness.view.seen == {"accepted placement.approach": 1}


async def test_rows_are_read_before_a_verdict_is_judged(witness: Witness) -> None:
    from tests.unit.lab.scripted_client import row

    dispatcher, reader = observed(witness)
    reader.rows.append(row(verdict=decided(id="1")))
    dispatcher.publish(decided(id="1"))
    assert witness.violation is None


async def test_a_daemon_that_was_lost_says_nothing_any_more(witness: Witness) -> None:
    old, _ = observed(witness)
    witness.lose_daemon(crash=True)
    old.publish(shown(0, states=READY))
    assert witness.violation is None
    new, _ = observed(witness)
    old.publish(shown(0, states=READY))
    assert witness.violation is None
    new.publish(shown(0, states={"robot": "1"}))
    assert witness.violation is not None
    assert witness.violation.invariant == "sequence_never_goes_back"


async def test_an_answer_is_judged_by_the_journal(witness: Witness) -> None:
    observed(witness)
    witness.answered(command(), decided(id="1"))
    assert witness.violation is not None
    assert witness.violation.invariant == "durable_before_known"


class ScriptedDevice:
    """A robot, or a stimulator, which does what it is asked."""

    name = "robot"

    def __init__(self) -> None:
        self.done: list[str] = []

    async def follow(self, _: Any) -> str:
        self.done.append("follow")
        return "arrived"

    async def press(self, _: Any) -> str:
        self.done.append("press")
        return "pressed"

    async def begin_servo(self) -> str:
        self.done.append("begin_servo")
        return "session"

    async def hold(self) -> str:
        self.done.append("hold")
        return "stands"

    async def states(self) -> AsyncIterator[Any]:
        yield joints(0.0)
        yield joints(0.5)

    async def fire(self, number: int) -> str:
        self.done.append(f"fire {number}")
        return "fired"


async def test_calls_of_a_robot_are_seen_and_passed_on(witness: Witness) -> None:
    device = ScriptedDevice()
    robot: Any = witness.watched({"robot": device})["robot"]
    assert [await robot.follow(None), await robot.press(None), await robot.begin_servo()] == [
        "arrived",
        "pressed",
        "session",
    ]
    assert await robot.hold() == "stands"
    assert device.done == ["follow", "press", "begin_servo", "hold"]
    assert robot.name == "robot"
    assert witness.violation is None
    await robot.follow(None)
    assert witness.violation is not None
    assert witness.violation.invariant == "nothing_begins_after_its_hold"


async def test_an_arm_that_moves_unasked_is_seen(witness: Witness) -> None:
    robot: Any = witness.watched({"robot": ScriptedDevice()})["robot"]
    speeds = [max(state.velocities, key=abs) async for state in robot.states()]
    assert len(speeds) == 2
    assert witness.violation is not None
    assert witness.violation.invariant == "nothing_moves_unasked"


async def test_a_pulse_that_nothing_allows_is_seen(witness: Witness) -> None:
    stimulator: Any = witness.watched({"stimulator": ScriptedDevice()})["stimulator"]
    assert await stimulator.fire(3) == "fired"
    assert witness.violation is not None
    assert witness.violation.text.startswith("Pulse 3 was given")


class ReportingDevice(ScriptedDevice):
    """One that has something to report."""

    async def events(self) -> AsyncIterator[Any]:
        yield event("drives_off", danger=True)


async def test_events_of_a_device_are_seen_and_passed_on(witness: Witness, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    monkeypatch.setattr(witness.watcher, "emitted", lambda event, _now: seen.append(event.code))
    found = witness.watched({"robot": ReportingDevice(), "stimulator": ReportingDevice()})
    for device in found.values():
        assert [each.code async for each in device.events()] == ["drives_off"]
    assert seen == ["drives_off"] * 2


async def test_commands_are_seen_when_they_arrive(witness: Witness) -> None:
    dispatcher, _ = observed(witness)
    witness.request_arrived("dev/robot/cmd", joints(0.0), 0.0)
    witness.request_arrived("cmd/anna/placement/approach", command(number="a1"), 0.0)
    witness.window_opened("plan:placement.approach", 0.5)
    witness.window_opened("send:robot.follow", 1e9)
    dispatcher.publish(shown(2, states=READY, running=[APPROACH]))
    assert witness.violation is not None
    assert witness.violation.invariant == "motions_begin_in_time"
    assert "0.500 s planning" in witness.violation.text


async def test_other_devices_are_served_as_they_are(witness: Witness) -> None:
    devices = {"scene": object(), "tracker": object()}
    found = witness.watched(devices)
    assert found["scene"] is devices["scene"]
    assert found["tracker"] is witness.tracker
    assert witness.watched({}) == {}


class ScriptedScene:
    """A scene whose arm can be looked at after each step."""

    def __init__(self) -> None:
        self.arm = SimpleNamespace(positions=[0.0], at_rest=True, stopped=None, reference=None)
        self.look: Callable[[], None] | None = None
        self.tool = Transform(np.eye(3), np.zeros(3))

    def is_near_body(self, _within: float) -> bool:
        return True

    @contextmanager
    def watched(self, look: Callable[[], None]) -> Iterator[None]:
        self.look = look
        yield
        self.look = None


async def test_a_tool_that_comes_near_an_unknown_body_is_seen(witness: Witness) -> None:
    observed(witness)
    scene = ScriptedScene()
    scene.arm.at_rest = False
    with witness.watching(scene):
        assert scene.look is not None
        for height in (0.04, 0.03):
            scene.tool = Transform(np.eye(3), np.array((0.0, 0.0, height)))
            scene.look()
    assert witness.violation is not None
    assert witness.violation.invariant == "the_tool_comes_near_only_when_ready"


async def test_the_arm_is_looked_at_after_every_step(witness: Witness) -> None:
    scene = ScriptedScene()
    with witness.watching(scene):
        assert scene.look is not None
        scene.look()
        scene.arm.positions = [0.5]
        scene.arm.reference = object.__new__(Relief)
        scene.look()
        assert witness.violation is None, "it relieves a force"
        scene.arm.reference = None
        scene.look()
        scene.arm.positions = [0.6]
        scene.look()
    assert witness.violation is not None
    assert witness.violation.invariant == "the_arm_stays"
