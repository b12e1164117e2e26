"""Listeners of a dispatcher: notified at once, and never able to break it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from pcmrs.messages import Command, DeviceEvent, Snapshot, Verdict


class DispatcherListener:
    """Receives notifications of a dispatcher, synchronously in its event loop.

    A subclass overrides what it needs. If it raises, the loop's exception handler gets the error, and everything else
    goes on.
    """

    def on_stop(self) -> None:
        """Handle a Stop, by whatever source; its latch is set already."""

    def on_failure(self) -> None:
        """Handle a failure after which the dispatcher accepts nothing any more; see `Dispatcher.broken`."""

    def on_accepted(self, command: Command) -> None:
        """Handle a command that was accepted, as soon as it is committed."""

    def on_publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        """Handle a new snapshot, verdict or device event."""


class Listeners:
    """Notifies all listeners, in the order in which they were added."""

    def __init__(self) -> None:
        self._listeners: list[DispatcherListener] = []

    def add(self, listener: DispatcherListener) -> None:
        """Add a listener."""
        self._listeners.append(listener)

    def notify_stop(self) -> None:
        """Notify all of a Stop."""
        for listener in self._listeners:
            _guarded(listener.on_stop)

    def notify_failure(self) -> None:
        """Notify all of a failure."""
        for listener in self._listeners:
            _guarded(listener.on_failure)

    def notify_accepted(self, command: Command) -> None:
        """Notify all of an accepted command."""
        for listener in self._listeners:
            _guarded(listener.on_accepted, command)

    def publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        """Hand a message to all."""
        for listener in self._listeners:
            _guarded(listener.on_publish, message)


def _guarded(notify: Callable[..., object], *arguments: object) -> None:
    """Notifies one listener: the loop reports its failure, which keeps nobody from stopping."""
    try:
        notify(*arguments)
    except Exception as error:
        context = {"message": f"{notify} has failed", "exception": error}
        asyncio.get_running_loop().call_exception_handler(context)
