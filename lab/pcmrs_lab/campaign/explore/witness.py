"""Watches a session from inside: every publication, motion, pulse and answer is checked against the invariants."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import msgspec

from pcmrs.devices.motion.press import Relief
from pcmrs.dispatcher import DispatcherListener
from pcmrs.fsm import Blueprint
from pcmrs.journal import JournalReader
from pcmrs.messages import (
    Command,
    DeviceEvent,
    FiredPulse,
    JointState,
    JointTrajectory,
    MotionResult,
    PressRequest,
    ServoSession,
    Snapshot,
    Verdict,
)
from pcmrs_lab.campaign.explore.invariants import INVARIANTS
from pcmrs_lab.campaign.explore.settings import DEADMAN
from pcmrs_lab.campaign.explore.tampering import TamperedTracker
from pcmrs_lab.campaign.explore.view import Answered, Fired, Moved, ObservedEvent, View
from pcmrs_lab.campaign.explore.watcher import NEAR, Watcher
from pcmrs_sim.deterministic.cell import Devices
from pcmrs_sim.deterministic.daemon import ProcedureDispatcher


@dataclass(frozen=True, slots=True)
class InvariantViolation:
    """InvariantViolation of an invariant.

    Attributes:
        invariant: Name of the invariant.
        text: Description of the violation.
        time: Time of the simulation, s.
    """

    invariant: str
    text: str
    time: float


class Witness:
    """Witness that checks every event against the invariants; the first violation counts.

    Attributes:
        view: Knowledge of the session.
        watcher: Watcher of the physical side.
        violation: First violation; None if there is none.
        violated: Set with the first violation.
        reader: Reader of the journal while a daemon runs.
        tracker: Tracker between the simulated one and its node; None before the devices are opened.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self.view = View(blueprint)
        self.watcher = Watcher(self.view, self.break_, DEADMAN)
        self.violation: InvariantViolation | None = None
        self.violated = asyncio.Event()
        self.reader: JournalReader | None = None
        self.tracker: TamperedTracker | None = None
        self._loop = asyncio.get_running_loop()
        self._run = 0

    def observe(self, dispatcher: ProcedureDispatcher, reader: JournalReader) -> None:
        """Observe a new run of the daemon.

        Args:
            dispatcher: Dispatcher of the run.
            reader: Reader of its journal.
        """
        self.reader = reader
        self.view.now = self._loop.time()
        self.view.begin_run()
        self._run = run = self.view.run
        dispatcher.add_listener(_RunListener(self, run))
        self.watcher.begin_run(dispatcher.snapshot())
        self.published(run, dispatcher.snapshot())

    def lose_daemon(self, *, crash: bool) -> None:
        """End the run; messages that the daemon still produces during its cleanup do not count."""
        self.view.now = self._loop.time()
        self.watcher.lose_daemon(self.view.now, crash=crash)
        self.view.end_run()
        self.reader = None
        self._run = 0

    def watched(self, devices: Devices) -> Devices:
        """Return the devices that the node serves, wrapped for observation."""
        found = dict(devices)
        if "robot" in found:
            found["robot"] = _WatchedRobot(found["robot"], self)
        if "tracker" in found:
            found["tracker"] = self.tracker = TamperedTracker(found["tracker"])
        if "stimulator" in found:
            found["stimulator"] = _WatchedStimulator(found["stimulator"], self)
        return found

    def answered(self, command: Command, verdict: Verdict) -> None:
        """Check a verdict that has reached the operator who sent the command.

        Args:
            command: Command of the operator.
            verdict: Verdict that was received.
        """
        self._take_rows()
        self.watcher.answered(command, verdict)
        self.judge(Answered(command, verdict))

    def request_arrived(self, _key: str, request: msgspec.Struct, at: float) -> None:
        """Take a request that has arrived at a process.

        Args:
            request: Request; only commands count.
            at: Time of its arrival, s.
        """
        if isinstance(request, Command):
            self.watcher.command_arrived(request.id, at)

    def window_opened(self, name: str, duration: float) -> None:
        """Take the name and the duration, s, of a window; only planning counts."""
        kind, _, operation = name.partition(":")
        if kind == "plan":
            self.watcher.planning(operation, self._loop.time(), duration)

    def emitted(self, event: DeviceEvent) -> None:
        """Take an event that a device has reported to its node."""
        self.watcher.emitted(event, self._loop.time())

    @contextmanager
    def watching(self, scene: Any) -> Iterator[None]:
        """Check the simulated arm after every step for the length of the context."""

        def look() -> None:
            arm, now = scene.arm, self._loop.time()
            relieving = isinstance(arm.reference, Relief)
            self.watcher.step(
                now,
                arm.positions,
                at_rest=arm.at_rest,
                braking=arm.stopped is not None,
                relieving=relieving,
            )
            if self.watcher.must_stay_away(now) and not (arm.at_rest or relieving):
                self.watcher.take_tool(scene.tool, near=scene.is_near_body(NEAR))
            else:
                self.watcher.forget_tool()

        with scene.watched(look):
            yield

    def judge(self, event: ObservedEvent) -> None:
        """Check an event against all invariants for its type."""
        self.view.now = self._loop.time()
        for invariant in INVARIANTS[type(event)]:
            text = invariant(self.view, event)
            if text is not None:
                self.break_(invariant.__name__, text)

    def break_(self, invariant: str, text: str) -> None:
        """Record a violation.

        Args:
            invariant: Name of the invariant.
            text: Description of the violation.
        """
        if self.violation is None:
            self.violation = InvariantViolation(invariant, text, self._loop.time())
            self.violated.set()

    def published(self, run: int, message: Snapshot | Verdict | DeviceEvent) -> None:
        """Check a message that a run of the daemon has published; messages of an ended run do not count.

        Args:
            run: Number of the run.
            message: Published message.
        """
        if run != self._run:
            return
        self.view.now = self._loop.time()
        if isinstance(message, Snapshot):
            self.view.take_snapshot(message)
            self.watcher.take_snapshot(message, self.view.now)
        if isinstance(message, Verdict):
            self.view.take_verdict(message)
            self.watcher.take_verdict(message)
        if isinstance(message, DeviceEvent):
            self.watcher.take_event(message, self.view.now)
        if not isinstance(message, DeviceEvent):
            self._take_rows()
        self.judge(message)

    def _take_rows(self) -> None:
        if self.reader is not None:
            self.view.take_rows(self.reader)


class _RunListener(DispatcherListener):
    """Listener that passes the messages of one run to the witness."""

    def __init__(self, witness: Witness, run: int) -> None:
        self._witness = witness
        self._run = run

    def on_publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        self._witness.published(self._run, message)


class _Watched:
    """Device whose calls are passed on."""

    def __init__(self, device: Any, witness: Witness) -> None:
        self._device, self._witness = device, witness

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    async def events(self) -> AsyncIterator[DeviceEvent]:
        async for event in self._device.events():
            self._witness.emitted(event)
            yield event


class _WatchedRobot(_Watched):
    async def follow(self, trajectory: JointTrajectory) -> MotionResult:
        self._begins("follow")
        result: MotionResult = await self._device.follow(trajectory)
        return result

    async def press(self, request: PressRequest) -> MotionResult:
        self._begins("press")
        result: MotionResult = await self._device.press(request)
        return result

    async def begin_servo(self) -> ServoSession:
        self._begins("begin_servo")
        session: ServoSession = await self._device.begin_servo()
        return session

    async def hold(self) -> JointState:
        self._witness.watcher.held(asyncio.get_running_loop().time())
        state: JointState = await self._device.hold()
        return state

    def _begins(self, method: str) -> None:
        self._witness.watcher.begins(method, asyncio.get_running_loop().time())

    async def states(self) -> AsyncIterator[JointState]:
        async for state in self._device.states():
            self._witness.judge(Moved(state))
            yield state


class _WatchedStimulator(_Watched):
    async def fire(self, number: int) -> FiredPulse:
        pulse: FiredPulse = await self._device.fire(number)
        self._witness.judge(Fired(number))
        return pulse
