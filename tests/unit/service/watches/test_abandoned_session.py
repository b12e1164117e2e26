"""A session that nobody attends to is held; one that somebody attends to never is."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest

from pcmrs.devices.link import Link
from pcmrs.dispatcher import Dispatcher, DispatcherListener
from pcmrs.messages import BlueprintTag, Command, DeviceEvent, Running, Snapshot, TeleopStatus
from pcmrs.messages.identity import HOLDING, ROLES, Role
from pcmrs.service._teleoperation import connect_teleoperators
from pcmrs.service.watches.abandoned import AbandonedWatch
from pcmrs.testing.clock import ManualClock, settle
from pcmrs.workflows.teleop_port import TeleopPort
from tests.support.shipped import shipped_blueprint

BLUEPRINT = shipped_blueprint("ratms_threshold")
AFTER = 10.0


class Unheard:
    """A link to nobody."""

    def publish(self, *_: object) -> None:
        pass

    def subscribe(self, *_: object) -> None:
        pass


class Session:
    """A dispatcher of which only the states matter."""

    def __init__(self, **branches: str) -> None:
        self.clock = ManualClock()
        self.branches = {"placement": "retracted", "stimulation": "disarmed", **branches}
        self.latched = False
        self.running: list[Running] = []
        self.reported: list[DeviceEvent] = []
        self.procedure = SimpleNamespace(blueprint=BLUEPRINT)
        self._listeners: list[DispatcherListener] = []
        watch = AbandonedWatch(cast(Dispatcher[Any, Any], self), AFTER, self.clock)
        self.watch = asyncio.create_task(watch.run())
        self.teleoperators = TeleopPort()
        connect_teleoperators(cast(Link, Unheard()), self.teleoperators, watch.see)

    def add_listener(self, listener: DispatcherListener) -> None:
        self._listeners.append(listener)

    def snapshot(self) -> Snapshot:
        tag = BlueprintTag(id="", version="", hash="")
        return Snapshot(
            sequence=1, branches=self.branches, flags={}, running=self.running, latched=self.latched, blueprint=tag
        )

    async def report(self, event: DeviceEvent) -> None:
        self.reported.append(event)
        self.latched = True

    async def let(self, seconds: float) -> None:
        await settle()
        await self.clock.advance(seconds)
        await settle()

    def accept(self, branch: str, operation: str, role: Role = "operator") -> None:
        command = Command(id="1", branch=branch, operation=operation, source="bus:somebody", role=role)
        for listener in self._listeners:
            listener.on_accepted(command)

    async def close(self) -> None:
        self.watch.cancel()
        with suppress(asyncio.CancelledError):
            await self.watch


@pytest.mark.parametrize(
    "branches",
    [{"placement": state} for state in ("standoff", "placed", "following")] + [{"stimulation": "armed"}],
)
async def test_tool_at_the_body_or_armed_stimulator_is_not_left_alone(branches: dict[str, str]) -> None:
    session = Session(**branches)
    await session.let(AFTER - 1.0)
    assert session.reported == []
    await session.let(1.5)
    (event,) = session.reported
    assert (event.code, event.danger) == ("session_abandoned", True)
    await session.let(10.0 * AFTER)
    assert len(session.reported) == 1, "it is latched: nothing is left to hold"
    await session.close()


@pytest.mark.parametrize("state", ["unknown", "retracted", "held"])
async def test_a_tool_that_is_away_or_held_may_be_left(state: str) -> None:
    session = Session(placement=state)
    await session.let(10.0 * AFTER)
    assert session.reported == []
    await session.close()


@pytest.mark.parametrize("role", HOLDING)
async def test_accepted_command_of_a_lease_holding_role_is_attendance(role: Role) -> None:
    session = Session(placement="placed")
    for _ in range(5):
        await session.let(AFTER - 1.0)
        session.accept("registration", "plan_landmarks", role)
    assert session.reported == []
    await session.let(AFTER + 0.5)
    assert session.reported
    await session.close()


@pytest.mark.parametrize("role", sorted(set(ROLES) - set(HOLDING)))
async def test_program_that_may_not_hold_the_lease_is_no_attendance(role: Role) -> None:
    session = Session(placement="placed")
    for _ in range(3):
        await session.let(AFTER / 3.0)
        session.accept("toolplan", "plan", role)
    await session.let(0.5)
    assert session.reported
    await session.close()


async def test_an_operation_that_takes_long_is_not_abandoned() -> None:
    session = Session(placement="placed")
    session.running = [Running(branch="placement", operation="confirm", id="1")]
    await session.let(3.0 * AFTER)
    assert session.reported == []
    session.running = []
    session.accept("placement", "confirm")
    await session.let(AFTER + 0.5)
    assert session.reported
    await session.close()


async def test_devices_are_nobody() -> None:
    session = Session(placement="following")
    session.accept("placement", "follow", "operator")
    for _ in range(3):
        await session.let(AFTER / 3.0)
        session.accept("alignment", "within", "daemon")
    await session.let(0.5)
    assert session.reported
    await session.close()


async def test_it_watches_on_after_an_operator_has_confirmed() -> None:
    session = Session(placement="placed")
    await session.let(AFTER + 0.5)
    session.latched = False
    session.accept("robot", "acknowledge")
    await session.let(2.5 * AFTER)
    assert len(session.reported) == 2
    await session.close()


async def test_guiding_hands_attend_and_waiting_ones_do_not() -> None:
    """A tool in the state guided that nobody guides yet is abandoned."""
    session = Session(placement="guided")
    status = TeleopStatus(stamp=0.0, distance=0.0, height=0.0, turn=0.0, user="alice", sequence=7)
    for _ in range(5):
        await session.let(AFTER - 1.0)
        session.teleoperators.publish(status)
    assert session.reported == []
    session.teleoperators.publish(msgspec.structs.replace(status, sequence=0))
    await session.let(AFTER + 0.5)
    assert session.reported
    await session.close()
