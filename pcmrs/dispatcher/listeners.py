"""Those who listen to a dispatcher."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from pcmrs.messages import Command, DeviceEvent, Snapshot, Verdict


class Listeners:
    """Calls everybody who listens, in the order in which they were added."""

    def __init__(self, publish: Callable[[Snapshot | Verdict | DeviceEvent], None]) -> None:
        self.on_publish = [publish]
        self.on_failure: list[Callable[[], None]] = []
        self.on_stop: list[Callable[[], None]] = []
        self.on_accepted: list[Callable[[Command], None]] = []

    def publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        for publish in self.on_publish:
            _guarded(publish, message)

    def notify_stop(self) -> None:
        for callback in self.on_stop:
            _guarded(callback)

    def notify_failure(self) -> None:
        for callback in self.on_failure:
            _guarded(callback)

    def notify_accepted(self, command: Command) -> None:
        for callback in self.on_accepted:
            _guarded(callback, command)


def _guarded(callback: Callable[..., object], *arguments: object) -> None:
    """Calls somebody who watches: what fails there is reported by the loop, and keeps nobody from stopping."""
    try:
        callback(*arguments)
    except Exception as error:
        context = {"message": f"{callback} has failed", "exception": error}
        asyncio.get_running_loop().call_exception_handler(context)
