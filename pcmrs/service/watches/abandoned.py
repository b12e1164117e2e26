"""A session that nobody attends to any more is made safe: held, latched, and nothing armed."""

from __future__ import annotations

from typing import Any

from pcmrs.clock import Clock
from pcmrs.dispatcher import Dispatcher, DispatcherListener
from pcmrs.fsm.exposure import Exposure
from pcmrs.messages import Command, DeviceEvent
from pcmrs.messages.identity import HOLDING


class AbandonedWatch(DispatcherListener):
    """Reports a danger when nobody has attended for too long while the patient is exposed.

    What exposes the patient, such as a tool at the body or an armed stimulator, goes by what the running blueprint
    declares: see `Exposure`.

    Who attends has a command accepted, in a role that may hold the lease: whoever asks in vain, or only plans, is none.
    Hands that guide the tool are a sign of a person, too. What devices report and activities post is none; an
    operation that still runs is one of whoever asked for it. The danger goes the way of Stop.

    Args:
        dispatcher: Of the cell.
        after: So long, s.
        clock: The machine's: people are as quick as ever in a simulation that runs faster.
    """

    def __init__(self, dispatcher: Dispatcher[Any, Any], after: float, clock: Clock) -> None:
        self._dispatcher = dispatcher
        self._after = after
        self._clock = clock
        self._exposure = Exposure(dispatcher.procedure.blueprint)
        self._asked = clock.monotonic()
        dispatcher.add_listener(self)

    async def run(self) -> None:
        """Watches until it is cancelled."""
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
        text = f"Nobody has asked for anything for {self._after:g} s (procedure.abandoned_after): the session is held."
        return DeviceEvent(
            device="operator",
            code="session_abandoned",
            text=f"{text} Confirm with {' or '.join(self._dispatcher.snapshot().release)} to go on.",
            danger=True,
            fields={"after": self._after},
        )

    def see(self) -> None:
        """Somebody is there."""
        self._asked = self._clock.monotonic()
