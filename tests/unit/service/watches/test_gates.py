"""What the nodes' beats say of latches and sessions, against what the daemon has decided."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import Any, cast

import msgspec
import pytest

from pcmrs.devices.remote import ActingDevice
from pcmrs.messages import DeviceEvent, GateState
from pcmrs.service.watches.gates import LATCHED, GateWatch

RELEASED = GateState(node="n", epoch=1, latched=False, daemon="d", changes=2)


class Device:
    """An `ActingDevice` without a bus."""

    name = "robot"

    def __init__(self) -> None:
        self.gate: GateState | None = None
        self.unreleased: tuple[str, int] | None = None
        self.taken_over = 0

    @property
    def foreign(self) -> bool:
        return self.gate is not None and self.gate.daemon not in ("", "d")

    def take(self, gate: GateState) -> None:
        self.gate = gate

    async def take_over(self) -> None:
        self.taken_over += 1


class Daemon:
    """Dispatcher and supervisor in one."""

    def __init__(self) -> None:
        self.procedure = self
        self.latched = False
        self.connected = True
        self.events: list[DeviceEvent] = []
        self.tasks: list[asyncio.Future[Any]] = []

    def report_later(self, event: DeviceEvent) -> None:
        self.events.append(event)

    def spawn(self, _name: str, work: Awaitable[None]) -> None:
        self.tasks.append(asyncio.ensure_future(work))


@pytest.fixture
def daemon() -> Daemon:
    return Daemon()


@pytest.fixture
def device() -> Device:
    return Device()


@pytest.fixture
def watch(daemon: Daemon, device: Device) -> GateWatch:
    anything = cast("Any", daemon)
    return GateWatch([cast("ActingDevice", device)], anything, lambda: daemon.connected, anything)


def latched(**other: Any) -> GateState:
    return msgspec.structs.replace(RELEASED, latched=True, **other)


def test_latched_device_of_an_unlatched_daemon_is_one_stop(watch: GateWatch, daemon: Daemon) -> None:
    watch.take("robot", RELEASED)
    assert daemon.events == []
    for _ in range(5):
        watch.take("robot", latched(epoch=2))
    assert [(event.code, event.danger, event.device) for event in daemon.events] == [(LATCHED, True, "robot")]
    watch.take("robot", latched(epoch=3))
    assert len(daemon.events) == 2, "it has stopped once more"
    watch.take("robot", latched(node="restarted", epoch=0))
    assert len(daemon.events) == 3


def test_before_the_first_connect_all_devices_are_latched(watch: GateWatch, daemon: Daemon) -> None:
    daemon.connected = False
    watch.take("robot", latched())
    assert daemon.events == []
    daemon.connected = True
    watch.take("robot", RELEASED)
    daemon.connected = False
    watch.take("robot", latched(epoch=2))
    assert len(daemon.events) == 1, "afterwards it counts, connected or not"


def test_latched_device_is_expected_while_the_daemon_is_latched(watch: GateWatch, daemon: Daemon) -> None:
    daemon.latched = True
    watch.take("robot", latched(epoch=2))
    assert daemon.events == []
    daemon.latched = False
    watch.take("robot", latched(epoch=2))
    assert len(daemon.events) == 1, "it was latched after it had been released, and nobody has seen it"


def test_device_that_could_not_be_released_is_known_as_latched(
    watch: GateWatch, daemon: Daemon, device: Device
) -> None:
    device.unreleased = ("n", 2)
    watch.take("robot", latched(epoch=2))
    assert daemon.events == []
    watch.take("robot", latched(epoch=3))
    assert len(daemon.events) == 1


async def test_device_of_an_earlier_daemon_is_taken_over_once(watch: GateWatch, daemon: Daemon, device: Device) -> None:
    for _ in range(3):
        watch.take("robot", msgspec.structs.replace(RELEASED, daemon="earlier"))
    await asyncio.gather(*daemon.tasks)
    assert device.taken_over == 1
    watch.take("robot", RELEASED)
    assert len(daemon.tasks) == 1


def test_a_device_that_does_not_act_is_none_of_its_business(watch: GateWatch, daemon: Daemon) -> None:
    watch.take("tracker", None)
    assert daemon.events == []
