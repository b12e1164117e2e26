"""Status for a service manager, by the protocol of sd_notify(3): one datagram of lines ``NAME=value``."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Mapping

import structlog

from pcmrs.clock import Clock
from pcmrs.messages.health import Health
from pcmrs.service.health.report import needs_restart
from pcmrs.service.supervisor import mark

log = structlog.get_logger(__name__)

STATUS_PERIOD = 5.0
"""Period of the status if no watchdog waits for it, s."""


class ServiceManager:
    """The service manager that has started this process, if one has.

    Args:
        environment: Environment with NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID; see sd_watchdog_enabled(3).

    Attributes:
        watched: It ends this process if the watchdog is not fed.
        period: Period of the feedings, half of the watchdog's limit, s of the machine.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        patience = environment.get("WATCHDOG_USEC", "")
        mine = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.watched = bool(address) and mine and patience.isascii() and patience.isdigit() and int(patience) > 0
        self.period = int(patience) / 2e6 if self.watched else STATUS_PERIOD

    def __bool__(self) -> bool:
        return bool(self._address)

    def notify(self, *lines: str) -> None:
        """Send lines without waiting, and log if that fails; do nothing without a service manager."""
        if not self:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as sender:
                sender.sendto("\n".join(lines).encode(), self._address)
        except OSError as error:
            log.warning("service_manager_not_told", said=lines, reason=error.strerror or str(error))


async def run_watchdog(manager: ServiceManager, health: Callable[[], Health], clock: Clock) -> None:
    """Send the status, and feed the watchdog as long as no restart is needed; until cancelled.

    It runs in the event loop: a loop that is blocked, or a process that is stopped, does not feed it.

    Args:
        manager: The service manager.
        health: Returns the present health.
        clock: The machine's clock.
    """
    while True:
        mark()
        now = health()
        fed = ("WATCHDOG=1",) if manager.watched and not needs_restart(now.reasons) else ()
        manager.notify(f"STATUS={status_line(now)}", *fed)
        await clock.sleep(manager.period)


def status_line(health: Health) -> str:
    """Return the health in one line."""
    why = "; ".join(reason.text for reason in health.reasons).replace("\n", " ")
    return f"{health.status}: {why}" if why else f"{health.status}: {health.blueprint.id} {health.blueprint.version}"
