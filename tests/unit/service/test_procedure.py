"""The procedure of a cell over a link in memory: beats, dead tasks, dead nodes, and who holds the robot then."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.devices.node import DAEMON_BEAT
from pcmrs.devices.standstill import MOVED, THRESHOLD
from pcmrs.errors import ConfigurationError, DeviceError, SupervisionError
from pcmrs.messages import (
    BodyPose,
    Command,
    DeviceEvent,
    DeviceHealth,
    DeviceReply,
    DeviceRequest,
    Epoch,
    GateState,
    JointState,
    NodeBeat,
    StimulatorState,
)
from pcmrs.service.procedure import Clocks, RunningProcedure, open_cell
from pcmrs.service.publishing import Publishing
from pcmrs.service.supervisor import RESTARTS, Supervisor
from pcmrs.settings import read_settings
from pcmrs.testing.clock import ManualClock, settle
from pcmrs.testing.driving import landmarks
from pcmrs.workflows.tms.data import Data
from tests.support.shipped import shipped_workflow

DISARMED = StimulatorState(armed=False, ready=True, intensity=50.0, coil_temperature=None, pulse=0)


RESTING = JointState(captured=1.0, sent=1.0, positions=[0.1] * 7, velocities=[0.0] * 7, torques=[0.0] * 7)


class FakeLink:
    """A bus whose robot rests, and whose stimulator is disarmed, whatever they are told."""

    def __init__(self) -> None:
        self.published: dict[str, list[Any]] = defaultdict(list)
        self.asked: list[str] = []
        self.failing: str | None = None
        self._subscribers: dict[str, Callable[[str, Any], None]] = {}

    def publish(self, key: str, message: msgspec.Struct) -> None:
        if key == self.failing:
            raise OSError("the link is out of order")
        self.published[key].append(message)

    def hear(self, expression: str, key: str, message: msgspec.Struct) -> None:
        self._subscribers[expression](key, message)

    def subscribe(self, key: str, kind: type[Any], handler: Callable[[str, Any], None]) -> None:
        self._subscribers[key] = handler

    def listen(self, key: str, kind: type[Any], handler: Callable[[str, Any], None]) -> None:
        raise AssertionError

    def when_lost(self, handler: Callable[[str], None]) -> None:
        self.lose = handler

    def serve(self, key: str, kind: type[Any], handler: Callable[[str, Any], Awaitable[msgspec.Struct]]) -> None:
        raise AssertionError

    async def request(
        self,
        key: str,
        message: msgspec.Struct,
        reply: type[Any],
        timeout: float,
        sender: str = "",
        *,
        urgent: bool = False,
    ) -> Any:
        assert isinstance(message, DeviceRequest)
        self.asked.append(f"{key.split('/')[1]}.{message.method}")
        gate = GateState(node="n", epoch=0, latched=False)
        result = None if message.method == "release_latch" else RESTING if "robot" in key else DISARMED
        return DeviceReply(result=msgspec.to_builtins(result), gate=gate)

    def alive(self, component: str) -> None:
        raise AssertionError


class FakeRecorder:
    def __init__(self) -> None:
        self.events: list[DeviceEvent] = []

    async def intent(self, command: Command, states: Mapping[str, str]) -> None:
        """Durable at once."""

    async def decision(self, *_arguments: Any, **_more: Any) -> None:
        """The same."""

    async def event(self, event: DeviceEvent, states: Mapping[str, str]) -> None:
        self.events.append(event)

    def recall(self, source: str, command_id: str) -> None:
        """Nothing was decided before."""


class Bench:
    def __init__(self) -> None:
        self.clock, self.link, self.recorder = ManualClock(), FakeLink(), FakeRecorder()
        self.supervisor = Supervisor(self.clock)
        self.asked = 0
        settings = read_settings()
        clocks = Clocks(self.clock, self.clock)
        workflow = shipped_workflow(settings.workflow)
        self.procedure = RunningProcedure(self.link, settings, workflow, self.recorder, clocks, self.supervisor)

    def hear_all(self) -> None:
        pose = BodyPose(body="coil", frame_number=1, captured=0.0, sent=0.0, valid=False)
        self.link.hear("state/pose/*", "state/pose/coil", pose)
        self.link.hear("state/joints", "state/joints", RESTING)
        for device in ("pointer", "scene", "stimulator", "emg"):
            self.link.hear("dev/*/state", f"dev/{device}/state", DeviceHealth(device=device, connected=True))
        gate = GateState(node="n", epoch=0, latched=False)
        for device in ("robot", "pointer", "stimulator"):
            self.link.hear("dev/*/beat", f"dev/{device}/beat", NodeBeat(number=1, sent=0.0, gate=gate))

    def codes(self) -> list[str]:
        return [event.code for event in self.recorder.events]

    async def connect(self) -> None:
        await self.accept("robot", "connect")

    async def accept(self, branch: str, operation: str, arguments: dict[str, Any] | None = None) -> None:
        self.asked += 1
        command = Command(
            id=str(self.asked), branch=branch, operation=operation, source="test:user", arguments=arguments or {}
        )
        verdict = await self.procedure.dispatcher.submit(command)
        assert verdict.decision == "accepted", verdict.reason


def test_a_real_tool_is_not_placed_by_simulated_poses() -> None:
    """Nor by the identity, unless the configuration says so."""
    blueprint, clocks = shipped_workflow("ratms").blueprint, Clocks(ManualClock(), ManualClock())
    far = ["robot.driver=kst", "kst.host=172.31.1.147"]
    serial = ["tracker.driver=ndi", "ndi.device=/dev/ttyUSB0"]
    for real in (["scene.driver=none"], ["tracker.driver=plus"], serial, far):
        with pytest.raises(ConfigurationError, match="pcmrs calibrate tip"):
            open_cell(read_settings(None, real), blueprint, FakeLink(), clocks, "s")
    virtual = ["robot.driver=kst", "tracker.driver=ndi"]
    assert open_cell(read_settings(None, virtual), blueprint, FakeLink(), clocks, "s")
    real = far
    for pose in ("flange_from_tool_marker", "tool_marker_from_tool_tip"):
        position = f"procedure.calibration.{pose}.position=[0.0, 0.0, 0.0]"
        with pytest.raises(ConfigurationError, match="quat_wxyz"):
            read_settings(None, [*real, position])
        real += [position, f"procedure.calibration.{pose}.quat_wxyz=[1.0, 0.0, 0.0, 0.0]"]
    cell = open_cell(read_settings(None, real), blueprint, FakeLink(), clocks, "s")
    np.testing.assert_array_equal(cell.flange_from_tool_tip.matrix, np.eye(4))


async def test_it_beats_and_records_when_each_node_was_heard() -> None:
    bench = Bench()
    async with bench.supervisor:
        bench.procedure.start()
        await settle()
        await bench.clock.advance(1.0)
        beats = bench.link.published[DAEMON_BEAT]
        assert [beat.number for beat in beats] == list(range(1, len(beats) + 1))
        assert {beat.session for beat in beats} == {bench.procedure.session}
        assert [beat.alive for beat in beats] == sorted({beat.alive for beat in beats}), (
            "each a sign of life of its own"
        )
        bench.link.hear("dev/*/beat", "dev/robot/beat", NodeBeat(number=1, sent=0.0))
        assert bench.procedure.beat_times == {"robot": bench.clock.monotonic()}
        late = DeviceHealth(device="robot", connected=True, dropped={"setpoints": 3})
        bench.link.hear("dev/*/state", "dev/robot/state", late)
        assert bench.procedure.counters() == {"robot.late.setpoints": 3, "events.misnamed": 0}


@pytest.mark.parametrize(
    ("key", "device", "taken"),
    [
        ("dev/tracker/event", "tracker", True),
        ("dev/tracker/event", "lease", False),
        ("dev/tracker/event", "daemon", False),
        ("dev/tracker/event", "robot", False),
        ("dev/lease/event", "lease", False),
        ("daemon/event", "recorder", True),
        ("daemon/event", "robot", False),
    ],
)
async def test_event_in_name_of_another_device_is_dropped_and_counted(key: str, device: str, taken: bool) -> None:
    bench = Bench()
    async with bench.supervisor:
        bench.procedure.start()
        event = DeviceEvent(device=device, code="something", text="")
        bench.link.hear("daemon/event" if key == "daemon/event" else "dev/*/event", key, event)
        await settle()
        assert ("something" in bench.codes()) is taken
        assert bench.procedure.counters()["events.misnamed"] == (not taken)


async def test_watch_that_cannot_continue_latches_and_ends_the_daemon() -> None:
    """The robot is held."""
    bench = Bench()

    async def run() -> None:
        async with bench.supervisor:
            bench.procedure.start()
            bench.link.failing = DAEMON_BEAT
            await asyncio.Event().wait()

    with pytest.raises(SupervisionError, match=r"beats and robot watch.*the link is out of order"):
        await run()
    codes = [event.code for event in bench.recorder.events if "daemon" in event.device]
    assert codes == ["task_restarted"] * RESTARTS + ["task_failed"]
    assert "robot.hold" in bench.link.asked
    assert bench.procedure.dispatcher.snapshot().latched


async def test_the_loss_of_the_robots_node_is_the_loss_of_the_robot() -> None:
    bench = Bench()
    async with bench.supervisor:
        bench.procedure.start()
        bench.hear_all()
        await bench.connect()
        assert bench.procedure.lose(["robot", "tracker"]), "it is worth another start"
        await settle()
        assert "link_lost" in bench.codes()
        snapshot = bench.procedure.dispatcher.snapshot()
        assert (snapshot.branches["robot"], snapshot.branches["placement"]) == ("0", "unknown")
        assert snapshot.latched
        await bench.procedure.dispatcher.close()


async def test_daemon_alone_stops_an_arm_that_moves_unasked() -> None:
    bench = Bench()
    async with bench.supervisor:
        bench.procedure.start()
        bench.hear_all()
        await bench.connect()
        await settle()
        bench.link.hear("state/joints", "state/joints", RESTING)
        bench.link.asked.clear()
        displaced = [*RESTING.positions[:-1], RESTING.positions[-1] + 2 * THRESHOLD]
        bench.link.hear("state/joints", "state/joints", msgspec.structs.replace(RESTING, positions=displaced))
        await settle()
        assert [event.danger for event in bench.recorder.events if event.code == MOVED] == [True]
        assert bench.procedure.dispatcher.snapshot().latched
        assert "robot.hold" in bench.link.asked
        await bench.procedure.dispatcher.close()


async def test_loss_of_the_stimulator_node_is_reported_as_disarmed() -> None:
    bench = Bench()
    async with bench.supervisor:
        bench.procedure.start()
        bench.hear_all()
        assert bench.procedure.lose(["stimulator"])
        await settle()
        assert "disarmed" in bench.codes()
        await bench.procedure.dispatcher.close()


async def test_a_node_that_ends_while_the_daemon_starts_ends_the_start() -> None:
    bench = Bench()
    async with bench.supervisor:
        bench.procedure.start()
        assert not bench.procedure.lose(["robot"])
        with pytest.raises(DeviceError, match="ended while it started"):
            await bench.procedure.readiness.wait()


async def test_procedure_data_is_published_whenever_it_changes() -> None:
    bench = Bench()
    told = bench.link.published["state/data"]
    async with bench.supervisor:
        bench.procedure.start()
        bench.hear_all()
        await bench.accept("registration", "plan_landmarks", landmarks())
        await settle()  # it is published after the answer
        names = [[each.name for each in data.landmarks] for data in told]
        assert names[-1] == [each["name"] for each in landmarks()["landmarks"]]
        assert told[-1] == bench.procedure.gathered()
        await bench.connect()
        await settle()
        assert len(told) == len(names), "nothing new was gathered"
        await bench.procedure.dispatcher.close()


async def test_each_muscle_signal_is_published_once() -> None:
    bench = Bench()
    publishing = Publishing(bench.link)
    signals = [Epoch(pulse=n, muscle="fdi", rate_hz=5000.0, start=-0.1, samples=[n * 1e-6]) for n in (1, 2)]
    for data in (Data(), Data(epoch=signals[0]), Data(epoch=signals[0], intensity=50.0), Data(epoch=signals[1])):
        publishing.publish_data(bench.procedure.cell, data)
    assert bench.link.published["state/epoch"] == signals
    assert [each.stimulation.intensity for each in bench.link.published["state/data"]] == [None, 50.0, None]


@pytest.mark.parametrize(("key", "device"), [("dev/robot/event", "robot"), ("daemon/event", "daemon")])
async def test_a_lost_event_may_have_been_a_danger_and_stops(key: str, device: str) -> None:
    bench = Bench()
    async with bench.supervisor:
        bench.procedure.start()
        await settle()
        bench.link.lose(key)
        await settle()
        assert bench.procedure.dispatcher.snapshot().latched
        assert (f"device:{device}", "events_lost") in [(event.device, event.code) for event in bench.recorder.events]
