"""A device node: serves devices on the bus, and stops the robot by itself when nobody else can."""

from __future__ import annotations

import asyncio
import uuid
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from functools import partial
from math import inf
from typing import Any

import msgspec
import structlog

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
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
from pcmrs.devices.frame_sessions import FrameSessions
from pcmrs.devices.gate import ACTS, HOLDS, RELEASE, Gate
from pcmrs.devices.link import Link
from pcmrs.devices.protocols import RobotDriver, StimulatorDriver, TrackerDriver
from pcmrs.devices.remote import HOLD_TIME
from pcmrs.devices.standstill import Standstill
from pcmrs.errors import DeviceError, PcmrsError
from pcmrs.messages import (
    Beat,
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
"""Devices that send by themselves, and are not well when they do not."""

STREAM_TIMEOUT = 1.0
"""A streaming device that has sent nothing for so long is not connected, s of the machine."""

HEALTH_PERIOD = 1.0
"""Between two words on a device's health, s of the machine."""

DAEMON_BEAT = "daemon/beat"
"""Key of the daemon's heartbeats: its own, so that no device's certificate can speak for the daemon."""

PULSE_DELAY = 0.5
"""A pulse that may have waited here for so long, because the node was held up, is not given, s of the machine."""

REQUEST_DELAY = 1.0
"""A request to act that has been on its way for so long is refused, s of the machine."""

MOTIONS = ACTS["robot"]
"""Methods of the robot that are refused when the daemon is not heard, too."""

HELD_UP_PERIOD = 5.0
"""Between two events that say that the node was held up, s of the machine: each is a row of the journal."""


class DeviceNode:
    """Serves the opened devices of one driver.

    Args:
        link: The bus.
        devices: Device name to device, as the driver has opened them.
        clock: The machine's clock: heartbeats do not run faster with a simulated cell.
        deadman: A moving robot is held, and an armed stimulator disarmed, when nothing fresh has been heard of the
            daemon for so long, s of the machine.
        scheduling: Of this process; by default it is never held up.

    Attributes:
        late: Kind of message to how many came too late to be followed.
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
        self._deadman = Deadman(deadman, self._at_risk, self._hold_for_silence, clock, self._tell_held_up, scheduling)
        session = uuid.uuid4().hex
        self._gates = {name: Gate(name, session) for name in devices if name in ACTS}
        self._standstill = Standstill()
        self.late: Counter[str] = Counter()
        self._moving = False
        self._begun = self._awake = clock.monotonic()
        self._held_up = self._told_held_up = -inf
        self._heard: dict[str, float] = {}
        self._frame_sessions = FrameSessions()
        self._holds = BackgroundTasks()

    async def run(self) -> None:
        """Serves until cancelled."""
        for name, device in self._devices.items():
            if methods_of(name):
                self._serve(name, device)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._beat())
            if "tracker" in self._devices:
                tasks.create_task(self._publish_frames(self._devices["tracker"]))
            if "robot" in self._devices or "stimulator" in self._devices:
                self._link.listen(DAEMON_BEAT, Beat, lambda _, beat: self._deadman.hear(beat))
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
        """Makes everything safe at once, whatever the daemon does; called on the lane of Stop."""
        self._holds.spawn(self.make_safe(f"stop by {source}"))

    def make_safe(self, why: str) -> Coroutine[Any, Any, None]:
        """Holds the robot and disarms the stimulator that are here; what is not confirmed is logged.

        Their gates are shut when this returns: what is awaited is only that they stand.
        """
        for gate in self._gates.values():
            gate.hold(latch=True)
        return self._make_safe(why)

    async def _make_safe(self, why: str) -> None:
        async with asyncio.TaskGroup() as tasks:
            if "robot" in self._devices:
                tasks.create_task(self._confirmed("hold", self._hold_robot, why))
            if "stimulator" in self._devices:
                tasks.create_task(self._confirmed("disarm", self._devices["stimulator"].disarm, why))

    async def _hold_robot(self) -> JointState:
        with self._standstill.moving():
            state: JointState = await self._devices["robot"].hold()
        return state

    async def _confirmed(self, what: str, ask: Callable[[], Awaitable[object]], why: str) -> None:
        try:
            async with self._clock.timeout(HOLD_TIME):
                await ask()
        except PcmrsError as error:
            log.warning(f"{what}_failed", why=why, reason=error.text)
        except TimeoutError:
            log.warning(f"{what}_failed", why=why, reason=f"not confirmed within {HOLD_TIME:g} s")
        except Exception:  # of a driver: nobody would watch over the device any more
            log.exception(f"{what}_failed", why=why)

    def _serve(self, name: str, device: Any) -> None:
        gate = self._gates.get(name)

        async def answer(_key: str, request: DeviceRequest) -> DeviceReply:
            result = failure = None
            call = partial(call_method, name, device, request.method, request.arguments)
            try:
                result = await (call() if gate is None else self._ask_acting(name, gate, call, request))
            except PcmrsError as error:
                failure = Reason(code=error.code, text=error.text, fields=error.fields)
            state = gate.state if gate is not None else None
            return DeviceReply(result=msgspec.to_builtins(result), failure=failure, gate=state)

        self._link.serve(f"dev/{name}/cmd", DeviceRequest, answer)

    async def _ask_acting(
        self, name: str, gate: Gate, call: Callable[[], Awaitable[Any]], request: DeviceRequest
    ) -> Any:
        """Performs a request to a device that acts.

        Raises:
            DeviceError: It was made for another situation than the present one, or the device refuses.
        """
        if request.method == HOLDS[name]:
            gate.hold(latch=request.latch, daemon=request.token.daemon if request.token is not None else "")
        elif request.method == RELEASE:
            await self._check_rest(name)
            gate.release(request.token)
            return None
        if request.method in ACTS[name]:
            gate.check(request.token)
            await self._check_fresh(name, request)
            gate.admit(request.token)  # after the last wait: a hold may have come meanwhile
        elif request.method == "connect":
            await self._check_fresh(name, request)
        return await (self._ask_robot(request.method, call) if name == "robot" else call())

    async def _ask_robot(self, method: str, call: Callable[[], Awaitable[Any]]) -> Any:
        if method == "joints":
            return await call()
        with self._standstill.moving(streamed=method == "begin_servo"):
            result = await call()
        if method in ("connect", "disconnect"):
            self._standstill.watch(method == "connect")
        return result

    def _follow_daemon(self, _key: str, beat: Beat) -> None:
        """What an earlier daemon has asked for ends with the first beat of a new one."""
        if beat.session == self._deadman.session and any(
            gate.state.daemon not in ("", beat.session) for gate in self._gates.values()
        ):
            self._holds.spawn(self.make_safe("another daemon has started"))
            for gate in self._gates.values():
                gate.forget_daemon()

    async def _check_rest(self, name: str) -> None:
        """Lets nobody release an arm that moves.

        Raises:
            DeviceError: It moves, or says nothing of itself.
        """
        if name != "robot":
            return
        state: JointState = await self._devices["robot"].joints()
        if state.moving:
            raise DeviceError("The robot still moves: it is released when it stands. Ask again.", code="moving")

    async def _beat(self) -> None:
        period, number = beat_period(self._deadman.limit), 0
        health_every = max(2, round(HEALTH_PERIOD / period))
        while True:
            number += 1
            for name in self._devices:
                gate = self._gates.get(name)
                state = gate.state if gate is not None else None
                self._link.publish(
                    f"dev/{name}/beat", NodeBeat(number=number, sent=self._clock.monotonic(), gate=state)
                )
                if number % health_every == 1 and (health := self._health(name)) is not None:
                    self._link.publish(f"dev/{name}/state", health)
            await self._clock.sleep(period)
            self._wake_up()

    def _wake_up(self) -> None:
        now = self._clock.monotonic()
        if now - self._awake > PULSE_DELAY:
            self._held_up = now
        self._awake = now

    async def _check_fresh(self, name: str, request: DeviceRequest) -> None:
        """Refuses what was asked for in another situation than the present one.

        Raises:
            DeviceError: The request is late, or nothing shows that who sent it is still there.
        """
        if (name, request.method) == ("stimulator", "fire"):
            self._check_not_held_up()
        if request.sent is None:
            return
        lateness, now = self._deadman.lateness, self._clock.monotonic()
        if (ahead := lateness.ahead(request.sent, now)) > REQUEST_DELAY:
            self.late["requests_ahead"] += 1
            text = f"{name}.{request.method} is stamped {ahead:.1f} s ahead of the daemon's clock, limit "
            text += f"{REQUEST_DELAY:g} s: it is not known when it was sent. Ask again."
            raise DeviceError(text, ahead=ahead, limit=REQUEST_DELAY)
        late = lateness.of(request.sent, now)
        if late > REQUEST_DELAY:
            self.late["requests"] += 1
            text = (
                f"{name}.{request.method} came {late:.1f} s late and was dropped, limit {REQUEST_DELAY:g} s: ask again."
            )
            raise DeviceError(text, late=late, limit=REQUEST_DELAY)
        if name == "robot" and request.method in MOTIONS:
            await self._check_heard()

    async def _check_heard(self) -> None:
        """Lets a motion begin only for a daemon that is there.

        Raises:
            DeviceError: The daemon is not heard.
        """
        heard, limit = await self._deadman.heard(), self._deadman.limit
        if not heard:
            text = f"The robot does not begin to move: its node has not heard the daemon for {limit:g} s. "
            text += "See that neither the network nor the machine is overloaded, and ask again."
            raise DeviceError(text, limit=limit)

    def _pass_on(self, robot: RobotDriver, setpoint: JointSetpoint) -> None:
        """A set point that came too late is none: where the arm shall be now is not where it should have been."""
        try:
            self._gates["robot"].check(setpoint.token)
        except DeviceError:
            self.late["setpoints"] += 1  # of before a hold
            return
        lateness, now = self._deadman.lateness, self._clock.monotonic()
        if max(lateness.of(setpoint.sent, now), lateness.ahead(setpoint.sent, now)) > self._deadman.limit:
            self.late["setpoints"] += 1
        else:
            robot.set_point(setpoint)

    def _check_not_held_up(self) -> None:
        """Refuses a pulse that may have waited here: coil and head were looked at before, not now."""
        self._wake_up()
        if self._awake - self._held_up < PULSE_DELAY:
            raise DeviceError("No pulse was given: the stimulator's node was held up just before. Fire again.")

    def _health(self, name: str) -> DeviceHealth | None:
        """None while it is too early to say."""
        beats = {"beats": self._deadman.late, "implausible_beats": self._deadman.implausible}
        dropped = dict(self.late) | {kind: many for kind, many in beats.items() if many}
        if name == "robot" and (stale := self._devices[name].dropped):
            dropped["stale_setpoints"] = stale
        if name not in STREAMING:
            return DeviceHealth(device=name, connected=True, dropped=dropped)
        now = self._clock.monotonic()
        if now - self._heard.get(name, self._begun) > STREAM_TIMEOUT:
            text = self._devices[name].trouble or "The device sends nothing."
            return DeviceHealth(device=name, connected=False, text=text, dropped=dropped)
        return DeviceHealth(device=name, connected=True, dropped=dropped) if name in self._heard else None

    async def _publish_frames(self, tracker: TrackerDriver) -> None:
        async for frame in tracker.frames():
            self._heard["tracker"] = self._clock.monotonic()
            for pose in self._frame_sessions.named(frame):
                self._link.publish(f"state/pose/{pose.body}", pose)

    async def _publish_joints(self, robot: RobotDriver) -> None:
        async for state in robot.states():
            self._moving = state.moving
            self._heard["robot"] = self._clock.monotonic()
            self._link.publish("state/joints", state)
            if (moved := self._standstill.take(state)) is not None:
                self._holds.spawn(self.make_safe(moved.text))
                self._link.publish("dev/robot/event", moved)

    async def _publish_events(self, name: str, device: RobotDriver | StimulatorDriver) -> None:
        async for event in device.events():
            if event.danger:
                self._gates[name].hold(latch=True)  # the device has stopped by itself: what is on its way is too late
            if event.code == "link_lost":
                self._standstill.watch(False)
            self._link.publish(f"dev/{name}/event", event)

    async def _hold_for_silence(self, silence: Silence) -> None:
        await asyncio.gather(self.make_safe("no heartbeat"), self._tell_silence(silence))

    async def _tell_silence(self, silence: Silence) -> None:
        load = self._scheduling.load()
        log.warning(
            "held_by_node",
            reason="no heartbeat of the daemon",
            silence=round(silence.lasted, 4),
            held_up=round(silence.held_up, 4),
            running=load.running,
            processors=load.processors,
        )
        self._tell_held_up(silence)
        device = self._risky()
        self._link.publish(f"dev/{device}/event", daemon_silent(device, silence, self._deadman.limit, load))

    def _tell_held_up(self, silence: Silence) -> None:
        now = self._clock.monotonic()
        if silence.held_up and now - self._told_held_up > HELD_UP_PERIOD:
            self._told_held_up = now
            device = self._risky()
            self._link.publish(f"dev/{device}/event", node_held_up(device, silence, self._scheduling.load()))

    def _risky(self) -> str:
        return "robot" if self._moving or "stimulator" not in self._devices else "stimulator"

    async def _at_risk(self) -> bool:
        """Whether anything moves or could fire."""
        if self._moving or "stimulator" not in self._devices:
            return self._moving
        try:
            async with self._clock.timeout(HOLD_TIME):
                state: StimulatorState = await self._devices["stimulator"].state()
        except Exception:  # nobody knows, and the watch must go on
            return True
        return state.armed
