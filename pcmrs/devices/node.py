"""A device node: serves devices on the bus, and makes them safe by itself if the daemon is silent."""

from __future__ import annotations

import asyncio
import itertools
import uuid
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from math import inf
from typing import Any

import msgspec
import structlog

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.devices._frame_sessions import FrameSessions
from pcmrs.devices.calls import call_method, methods_of
from pcmrs.devices.deadman import (
    ALWAYS_SERVED,
    DEADMAN,
    Deadman,
    Scheduling,
    Silence,
    beat_period,
    daemon_silent,
    node_held_up,
)
from pcmrs.devices.gate import ACTS, HOLD_TIME, HOLDS, RELEASE, Gate
from pcmrs.devices.link import Link
from pcmrs.devices.protocols import BeepingTracker, RobotDriver, StimulatorDriver, TrackerDriver
from pcmrs.devices.standstill import Standstill
from pcmrs.errors import DeviceError, PcmrsError, UnknownOutcomeError
from pcmrs.messages import (
    Beat,
    Beeps,
    DeviceHealth,
    DeviceReply,
    DeviceRequest,
    JointSetpoint,
    JointState,
    NodeBeat,
    Reason,
    StimulatorState,
)

log = structlog.get_logger(__name__)

STREAMING = ("robot", "tracker")
"""Devices that stream data; one that sends none is not healthy."""

STREAM_TIMEOUT = 1.0
"""Time without data after which a streaming device counts as not connected, s of the machine."""

HEALTH_PERIOD = 1.0
"""Time between two reports of a device's health, s of the machine."""
PASSIVE_PERIOD = 0.25
"""Time between two heartbeats of a device that does not act, s of the machine: only its health depends on them."""

DAEMON_BEAT = "daemon/beat"
"""Key of the daemon's heartbeats. It is not a device's key, so that no device's certificate can forge them."""

PULSE_DELAY = 0.5
"""A pulse that may have waited here for this long, because the node was held up, is not given, s of the machine."""

REQUEST_DELAY = 1.0
"""Delay on the way beyond which an acting request is refused, s of the machine."""

MOTIONS = ACTS["robot"]
"""Methods of the robot that are also refused while the daemon is silent."""

HELD_UP_PERIOD = 5.0
"""Shortest time between two events of a node that was held up, s of the machine: each is a row of the journal."""


class DeviceNode:
    """Server of the opened devices of one driver.

    Args:
        link: Bus.
        devices: Devices by name, as the driver has opened them.
        clock: Clock of the machine: heartbeats do not run faster with a simulated cell.
        deadman: Time without a fresh heartbeat of the daemon after which a moving robot is held and an armed stimulator
            disarmed, s of the machine.
        scheduling: Scheduling of this process; by default it is never held up.

    Attributes:
        late: Number of messages that were dropped because they arrived too late, by kind.
    """

    def __init__(
        self,
        link: Link,
        devices: Mapping[str, Any],
        clock: Clock,
        deadman: float = DEADMAN,
        scheduling: Scheduling = ALWAYS_SERVED,
    ) -> None:
        self._link = link
        self._devices = devices
        self._clock = clock
        self._scheduling = scheduling
        self._deadman = Deadman(deadman, self._at_risk, self._hold_for_silence, clock, self._report_held_up, scheduling)
        session = uuid.uuid4().hex
        self._gates = {name: Gate(name, session) for name in devices if name in ACTS}
        self._standstill = Standstill()
        self.late: Counter[str] = Counter()
        self._moving = False
        self._started_at = self._last_turn = clock.monotonic()
        self._held_up_at = self._reported_held_up_at = -inf
        self._last_data: dict[str, float] = {}
        self._frame_sessions = FrameSessions()
        self._holds = BackgroundTasks()

    async def run(self) -> None:
        """Serve until cancelled."""
        for name, device in self._devices.items():
            if methods_of(name):
                self._serve(name, device)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._beat())
            if "tracker" in self._devices:
                tasks.create_task(self._publish_frames(self._devices["tracker"]))
                if isinstance(self._devices["tracker"], BeepingTracker):
                    beeper: BeepingTracker = self._devices["tracker"]
                    self._link.subscribe("dev/tracker/beep", Beeps, lambda _, beeps: beeper.beep(beeps.count))
            if "robot" in self._devices or "stimulator" in self._devices:
                self._link.listen(DAEMON_BEAT, Beat, lambda _, beat: self._deadman.take_beat(beat))
                self._link.subscribe(DAEMON_BEAT, Beat, self._follow_daemon)
                tasks.create_task(self._deadman.run())
            if "robot" in self._devices:
                robot: RobotDriver = self._devices["robot"]
                self._link.subscribe("dev/robot/setpoint", JointSetpoint, lambda _, each: self._pass_on(robot, each))
                tasks.create_task(self._publish_joints(robot))
                tasks.create_task(self._publish_events("robot", robot))
            if "stimulator" in self._devices:
                tasks.create_task(self._publish_events("stimulator", self._devices["stimulator"]))

    def stop(self, source: str) -> None:
        """Make all devices safe at once, without the daemon; called by the lane of Stop."""
        self._holds.spawn(self.make_safe(f"stop by {source}"))

    def make_safe(self, why: str) -> Coroutine[Any, Any, None]:
        """Hold the robot and disarm the stimulator of this node; a failure to confirm that is logged.

        The gates are shut when this returns: the caller awaits only that the devices are at rest.
        """
        for gate in self._gates.values():
            gate.hold(latch=True)
        return self._make_safe(why)

    async def _make_safe(self, why: str) -> None:
        async with asyncio.TaskGroup() as tasks:
            if "robot" in self._devices:
                tasks.create_task(self._confirm("hold", self._hold_robot, why))
            if "stimulator" in self._devices:
                tasks.create_task(self._confirm("disarm", self._devices["stimulator"].disarm, why))

    async def _hold_robot(self) -> JointState:
        with self._standstill.moving():
            state: JointState = await self._devices["robot"].hold()
        return state

    async def _confirm(self, action: str, act: Callable[[], Awaitable[object]], why: str) -> None:
        try:
            async with self._clock.timeout(HOLD_TIME):
                await act()
        except PcmrsError as error:
            log.warning(f"{action}_failed", why=why, reason=error.text)
        except TimeoutError:
            log.warning(f"{action}_failed", why=why, reason=f"not confirmed within {HOLD_TIME:g} s")
        except Exception:  # a defect of a driver must not end the node that watches the device
            log.exception(f"{action}_failed", why=why)

    def _serve(self, name: str, device: Any) -> None:
        gate = self._gates.get(name)

        async def answer(_key: str, request: DeviceRequest) -> DeviceReply:
            result = failure = None
            call = partial(call_method, name, device, request.method, request.arguments)
            try:
                result = await (call() if gate is None else self._perform(name, gate, call, request))
            except PcmrsError as error:
                failure = Reason(code=error.code, text=error.text, fields=error.fields)
            state = gate.state if gate is not None else None
            return DeviceReply(result=msgspec.to_builtins(result), failure=failure, gate=state)

        self._link.serve(f"dev/{name}/cmd", DeviceRequest, answer)

    async def _perform(self, name: str, gate: Gate, call: Callable[[], Awaitable[Any]], request: DeviceRequest) -> Any:
        """Perform a request to an acting device.

        Raises:
            DeviceError: The request was made for other sessions or another epoch, or the device refuses it.
        """
        if request.method == HOLDS[name]:
            gate.hold(latch=request.latch, daemon=request.token.daemon if request.token is not None else "")
        elif request.method == RELEASE:
            await self._check_stationary(name)
            gate.release(request.token)
            return None
        if request.method in ACTS[name]:
            gate.check(request.token)
            await self._check_fresh(name, request)
            gate.admit(request.token)  # after the last await: a hold may have arrived meanwhile
        elif request.method == "connect":
            await self._check_fresh(name, request)
        return await (self._perform_on_robot(request.method, call) if name == "robot" else call())

    async def _perform_on_robot(self, method: str, call: Callable[[], Awaitable[Any]]) -> Any:
        if method == "joints":
            return await call()
        with self._standstill.moving(streamed=method == "begin_servo"):
            result = await call()
        if method in ("connect", "disconnect"):
            self._standstill.watch(method == "connect")
        return result

    def _follow_daemon(self, _key: str, beat: Beat) -> None:
        """End what an earlier daemon has started with the first heartbeat of a new one."""
        if beat.session == self._deadman.session and any(
            gate.state.daemon not in ("", beat.session) for gate in self._gates.values()
        ):
            self._holds.spawn(self.make_safe("another daemon has started"))
            for gate in self._gates.values():
                gate.forget_daemon()

    async def _check_stationary(self, name: str) -> None:
        """Refuse to release an arm that moves, or that is not measured now.

        Raises:
            DeviceError: The arm moves, or refuses to report its joints.
            UnknownOutcomeError: It does not report them in time.
        """
        if name != "robot":
            return
        try:
            async with self._clock.timeout(HOLD_TIME):
                state: JointState = await self._devices["robot"].joints()
        except TimeoutError:  # the daemon has given this release up, too
            text = f"The robot reported no joints within {HOLD_TIME:g} s and stays latched. Look at the arm, ask again."
            raise UnknownOutcomeError(text, limit=HOLD_TIME) from None
        if state.moving:
            raise DeviceError("The robot still moves: it can be released when it stands. Ask again.", code="moving")

    async def _beat(self) -> None:
        period = beat_period(self._deadman.limit)
        passive_every, health_every = (max(1, int(each / period)) for each in (PASSIVE_PERIOD, HEALTH_PERIOD))
        for turn in itertools.count():
            for name in self._devices:
                gate = self._gates.get(name)
                every = 1 if gate is not None else passive_every
                if turn % every == 0:
                    state = gate.state if gate is not None else None
                    beat = NodeBeat(number=turn // every + 1, sent=self._clock.monotonic(), gate=state)
                    self._link.publish(f"dev/{name}/beat", beat)
                if turn % health_every == 0 and (health := self._health(name)) is not None:
                    self._link.publish(f"dev/{name}/state", health)
            await self._clock.sleep(period)
            self._note_turn()

    def _note_turn(self) -> None:
        now = self._clock.monotonic()
        if now - self._last_turn > PULSE_DELAY:
            self._held_up_at = now
        self._last_turn = now

    async def _check_fresh(self, name: str, request: DeviceRequest) -> None:
        """Refuse a request that was on its way for too long.

        Raises:
            DeviceError: The request is late, or its daemon is silent.
        """
        if (name, request.method) == ("stimulator", "fire"):
            self._check_not_held_up()
        if request.sent is None:
            return
        lateness, now = self._deadman.lateness, self._clock.monotonic()
        if (ahead := lateness.ahead(request.sent, now)) > REQUEST_DELAY:
            self.late["requests_ahead"] += 1
            text = f"The time stamp of {name}.{request.method} is {ahead:.1f} s ahead of the daemon's clock, limit "
            text += f"{REQUEST_DELAY:g} s: the time of sending is unknown. Ask again."
            raise DeviceError(text, ahead=ahead, limit=REQUEST_DELAY)
        late = lateness.delay(request.sent, now)
        if late > REQUEST_DELAY:
            self.late["requests"] += 1
            text = (
                f"{name}.{request.method} was {late:.1f} s late and was dropped, limit {REQUEST_DELAY:g} s: ask again."
            )
            raise DeviceError(text, late=late, limit=REQUEST_DELAY)
        if name == "robot" and request.method in MOTIONS:
            await self._check_daemon_alive()

    async def _check_daemon_alive(self) -> None:
        """Let a motion begin only if the daemon is alive.

        Raises:
            DeviceError: The daemon is silent.
        """
        alive, limit = await self._deadman.wait_for_daemon(), self._deadman.limit
        if not alive:
            text = f"The robot does not begin to move: its node has received no heartbeat of the daemon for {limit:g} "
            text += "s. Make sure that neither the network nor the machine is overloaded, and ask again."
            raise DeviceError(text, limit=limit)

    def _pass_on(self, robot: RobotDriver, setpoint: JointSetpoint) -> None:
        """Pass a set point on to the robot; a late one is dropped, because it is not where the arm should be now."""
        try:
            self._gates["robot"].check(setpoint.token)
        except DeviceError:
            self.late["setpoints"] += 1  # it was sent before a hold
            return
        lateness, now = self._deadman.lateness, self._clock.monotonic()
        if max(lateness.delay(setpoint.sent, now), lateness.ahead(setpoint.sent, now)) > self._deadman.limit:
            self.late["setpoints"] += 1
        else:
            robot.set_point(setpoint)

    def _check_not_held_up(self) -> None:
        """Refuse a pulse that may have waited here: the placement of the coil was checked before that wait."""
        self._note_turn()
        if self._last_turn - self._held_up_at < PULSE_DELAY:
            raise DeviceError("No pulse was given: the stimulator's node was held up just before. Fire again.")

    def _health(self, name: str) -> DeviceHealth | None:
        """Return the health of a device; None while it is too early to tell."""
        beats = {"beats": self._deadman.late, "implausible_beats": self._deadman.implausible}
        dropped = dict(self.late) | {kind: many for kind, many in beats.items() if many}
        if name == "robot" and (stale := self._devices[name].dropped):
            dropped["stale_setpoints"] = stale
        if name not in STREAMING:
            return DeviceHealth(device=name, connected=True, dropped=dropped)
        now = self._clock.monotonic()
        if now - self._last_data.get(name, self._started_at) > STREAM_TIMEOUT:
            text = self._devices[name].trouble or "The device sends nothing."
            return DeviceHealth(device=name, connected=False, text=text, dropped=dropped)
        return DeviceHealth(device=name, connected=True, dropped=dropped) if name in self._last_data else None

    async def _publish_frames(self, tracker: TrackerDriver) -> None:
        async for frame in tracker.frames():
            self._last_data["tracker"] = self._clock.monotonic()
            for pose in self._frame_sessions.named(frame):
                self._link.publish(f"state/pose/{pose.body}", pose)

    async def _publish_joints(self, robot: RobotDriver) -> None:
        async for state in robot.states():
            self._moving = state.moving
            self._last_data["robot"] = self._clock.monotonic()
            self._link.publish("state/joints", state)
            if (moved := self._standstill.take(state)) is not None:
                self._holds.spawn(self.make_safe(moved.text))
                self._link.publish("dev/robot/event", moved)

    async def _publish_events(self, name: str, device: RobotDriver | StimulatorDriver) -> None:
        async for event in device.events():
            if event.danger:
                self._gates[name].hold(latch=True)  # the device has stopped by itself: requests on their way are stale
            if event.code == "link_lost":
                self._standstill.watch(False)
            self._link.publish(f"dev/{name}/event", event)

    async def _hold_for_silence(self, silence: Silence) -> None:
        await asyncio.gather(self.make_safe("no heartbeat"), self._report_silence(silence))

    async def _report_silence(self, silence: Silence) -> None:
        with _errors_logged():
            load = self._scheduling.load()
            log.warning(
                "held_by_node",
                reason="no heartbeat of the daemon",
                silence=round(silence.lasted, 4),
                held_up=round(silence.held_up, 4),
                running=load.running,
                processors=load.processors,
            )
            self._report_held_up(silence)
            device = self._device_at_risk()
            self._link.publish(f"dev/{device}/event", daemon_silent(device, silence, self._deadman.limit, load))

    def _report_held_up(self, silence: Silence) -> None:
        with _errors_logged():
            now = self._clock.monotonic()
            if silence.held_up and now - self._reported_held_up_at > HELD_UP_PERIOD:
                self._reported_held_up_at = now
                device = self._device_at_risk()
                self._link.publish(f"dev/{device}/event", node_held_up(device, silence, self._scheduling.load()))

    def _device_at_risk(self) -> str:
        return "robot" if self._moving or "stimulator" not in self._devices else "stimulator"

    async def _at_risk(self) -> bool:
        """Return True if anything moves or could fire."""
        if self._moving or "stimulator" not in self._devices:
            return self._moving
        try:
            async with self._clock.timeout(HOLD_TIME):
                state: StimulatorState = await self._devices["stimulator"].state()
        except Exception:  # its state is unknown, and the deadman must go on
            return True
        return state.armed


@contextmanager
def _errors_logged() -> Iterator[None]:
    """Log an error of a report, so that it never ends the deadman."""
    try:
        yield
    except Exception:
        log.exception("report_failed")
