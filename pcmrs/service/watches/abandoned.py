"""Watch that makes an unattended session safe: held, latched and disarmed."""

from __future__ import annotations

from typing import Any

from pcmrs.clock import Clock
from pcmrs.dispatcher import Dispatcher, DispatcherListener
from pcmrs.fsm.exposure import Exposure
from pcmrs.messages import Command, DeviceEvent
from pcmrs.messages.identity import HOLDING


class AbandonedWatch(DispatcherListener):
    """Watch that reports a danger if nobody has attended for too long while the patient is exposed.

    The running blueprint declares what exposes the patient, such as a tool at the body or an armed stimulator: see
    `Exposure`.

    A person attends whose command is accepted, in a role that may hold the lease; rejected commands and plans do not
    count. A person also attends whose hands guide the tool. Reports of devices and commands of activities do not count;
    an operation that still runs does. The danger stops everything.

    Args:
        dispatcher: The dispatcher of the cell.
        after: Limit, s.
        clock: The machine's clock: people are no faster in a simulation that runs faster.
    """

    def __init__(self, dispatcher: Dispatcher[Any, Any], after: float, clock: Clock) -> None:
        self._dispatcher = dispatcher
        self._after = after
        self._clock = clock
        self._exposure = Exposure(dispatcher.procedure.blueprint)
        self._asked = clock.monotonic()
        dispatcher.add_listener(self)

    async def run(self) -> None:
        """Watch until cancelled."""
        while True:
            left = self._asked + self._after - self._clock.monotonic()
            await self._clock.sleep(left if left > 0.0 else self._after)
            if self._clock.monotonic() - self._asked >= self._after and self._exposed():
                await self._dispatcher.report(self._event())

    def on_accepted(self, command: Command) -> None:
        """Count an accepted command as a sign of a person, if its role may hold the lease."""
        if command.role in HOLDING:
            self.see()

    def _exposed(self) -> bool:
        snapshot = self._dispatcher.snapshot()
        if snapshot.latched or snapshot.running:
            return False
        return self._exposure.holds(snapshot.branches)

    def _event(self) -> DeviceEvent:
        text = f"Nobody has attended for {self._after:g} s (procedure.abandoned_after): the session is held."
        return DeviceEvent(
            device="operator",
            code="session_abandoned",
            text=f"{text} Confirm with {' or '.join(self._dispatcher.snapshot().release)} to go on.",
            danger=True,
            fields={"after": self._after},
        )

    def see(self) -> None:
        """Note that a person attends."""
        self._asked = self._clock.monotonic()
