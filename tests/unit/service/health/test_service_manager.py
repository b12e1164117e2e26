"""What a service manager is told, heard at the other end of a real socket."""

from __future__ import annotations

import asyncio
import os
import socket
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace
from structlog.testing import capture_logs

from pcmrs.messages.health import Health, HealthFacts, TaskStanding
from pcmrs.service.health.report import report
from pcmrs.service.health.service_manager import STATUS_PERIOD, ServiceManager, run_watchdog
from pcmrs.service.supervisor import Supervisor
from pcmrs.testing.clock import ManualClock, settle
from tests.support.health_facts import WELL

WATCHED = {"WATCHDOG_USEC": "4000000"}


class Heard:
    """The socket of a service manager."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.bind(f"\0{address[1:]}" if address.startswith("@") else address)

    def manager(self, **environment: str) -> ServiceManager:
        return ServiceManager({"NOTIFY_SOCKET": self.address, **environment})

    def messages(self) -> list[list[str]]:
        """What has come since the last call."""
        found: list[list[str]] = []
        while True:
            try:
                found.append(self._socket.recv(4096).decode().split("\n"))
            except BlockingIOError:
                return found

    def close(self) -> None:
        self._socket.close()


@pytest.fixture(params=["path", "abstract"])
def heard(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Heard]:
    address = f"@pcmrs-{uuid.uuid4().hex}" if request.param == "abstract" else str(tmp_path / "s")
    made = Heard(address)
    yield made
    made.close()


class Daemon:
    """Keeps a manager informed of facts that a test sets."""

    def __init__(self, manager: ServiceManager) -> None:
        self.facts: HealthFacts = WELL
        self.clock = ManualClock()
        self.period = manager.period
        self._task = asyncio.create_task(run_watchdog(manager, self._health, self.clock))

    def _health(self) -> Health:
        return report(self.facts)

    async def end(self) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)


async def test_watchdog_is_fed_at_half_its_time_with_a_status_line(heard: Heard) -> None:
    manager = heard.manager(**WATCHED, WATCHDOG_PID=str(os.getpid()))
    assert manager.period == 2.0
    daemon = Daemon(manager)
    await settle()
    fed = ["STATUS=ok: ratms 1.0.0", "WATCHDOG=1"]
    assert heard.messages() == [fed]
    await daemon.clock.advance(1.9)
    assert heard.messages() == []
    await daemon.clock.advance(0.2)
    assert heard.messages() == [fed]
    await daemon.end()


async def test_hung_task_ends_the_feeding_and_is_named_in_the_status(heard: Heard) -> None:
    manager, clock = heard.manager(**WATCHED), ManualClock()

    def health() -> Health:
        now = clock.monotonic()
        statuses = [
            TaskStanding(name=each.name, answers=each.answers(now), restarts=each.restarts)
            for each in supervisor.statuses()
        ]
        return report(replace(WELL, tasks=statuses))

    async def hangs() -> None:
        await asyncio.Event().wait()

    supervisor = Supervisor(clock)
    async with supervisor:
        supervisor.start("service manager", lambda: run_watchdog(manager, health, clock))
        supervisor.start("hanging", hangs, quiet=5.0)
        await settle()
        await clock.advance(4.5)
        assert [lines[-1] for lines in heard.messages()] == ["WATCHDOG=1"] * 3
        await clock.advance(4.0)
        unfed = heard.messages()
        assert len(unfed) == 2
        for (status,) in unfed:
            assert status.startswith("STATUS=failed: ")
            assert "'hanging'" in status


async def test_a_device_that_is_lost_does_not_end_the_feeding(heard: Heard) -> None:
    daemon = Daemon(heard.manager(**WATCHED))
    devices = [replace(device, connected=False, text="Un\nplugged.") for device in WELL.devices]
    daemon.facts = replace(WELL, devices=devices)
    await settle()
    ((status, fed),) = heard.messages()
    assert fed == "WATCHDOG=1"
    assert status.startswith("STATUS=degraded: emg is not connected: Un plugged.")
    await daemon.end()


@pytest.mark.parametrize(
    "environment", [{}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "x"}, {**WATCHED, "WATCHDOG_PID": "1"}]
)
async def test_without_a_watchdog_for_this_process_only_status_is_sent(
    heard: Heard, environment: dict[str, str]
) -> None:
    daemon = Daemon(heard.manager(**environment))
    await settle()
    assert daemon.period == STATUS_PERIOD
    assert heard.messages() == [["STATUS=ok: ratms 1.0.0"]]
    await daemon.end()


def test_without_a_service_manager_nothing_is_sent() -> None:
    manager = ServiceManager(WATCHED)
    assert not manager
    assert not manager.watched
    with capture_logs() as told:
        manager.notify("READY=1")
    assert told == []


def test_unreachable_service_manager_is_logged(heard: Heard) -> None:
    manager = heard.manager()
    heard.close()
    with capture_logs() as told:
        manager.notify("READY=1")
    assert [(each["event"], each["said"]) for each in told] == [("service_manager_not_told", ("READY=1",))]
