"""The deadman of a device node: makes its device safe when no fresh heartbeat of the daemon arrives.

It also makes the events that report this, with the load of the machine at that time.
"""

from __future__ import annotations

import threading
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Protocol

from pcmrs.clock import Clock
from pcmrs.devices.lateness import Lateness
from pcmrs.messages import Beat, DeviceEvent
from pcmrs.threads import Load


def daemon_silent(device: str, silence: Silence, limit: float, load: Load) -> DeviceEvent:
    """Return the danger event of a node that has made its device safe by itself.

    Args:
        device: Device that moved, or could have fired.
        silence: Silence of the daemon.
        limit: Limit of the deadman, s of the machine.
        load: Load of the node's machine just afterwards.
    """
    text = f"The node of the {device} has made it safe by itself: it had received no heartbeat of the daemon for "
    text += f"{silence.lasted * 1e3:.0f} ms, limit {limit * 1e3:.0f} ms.{_cause(silence, load)} "
    text += "Nothing continues by itself: look at the cell, then acknowledge."
    fields = {"silence": silence.lasted, "limit": limit, **_fields(silence, load)}
    return DeviceEvent(device=device, code="daemon_silent", text=text, danger=True, fields=fields)


def node_held_up(device: str, silence: Silence, load: Load) -> DeviceEvent:
    """Return the event of a node that got no processor time, and so could not receive heartbeats in time.

    Args:
        device: Device that the node watches.
        silence: Silence of the daemon before the node had received the messages that arrived meanwhile.
        load: Load of the node's machine just afterwards.
    """
    text = f"The node of the {device} was held up.{_cause(silence, load)} Stop other programs on this machine. "
    text += "pcmrs-serve reports at its start which permissions it lacks to run ahead of them."
    return DeviceEvent(device=device, code="node_held_up", text=text, fields=_fields(silence, load))


def _cause(silence: Silence, load: Load) -> str:
    if silence.held_up:
        return f" The node had waited {silence.held_up * 1e3:.0f} ms for a processor: {load}."
    return f" The machine is overloaded: {load}." if load.is_too_high else ""


def _fields(silence: Silence, load: Load) -> dict[str, float | None]:
    return {"held_up": silence.held_up, "running": load.running, "processors": load.processors}


DEADMAN = 0.1
"""Default time without a fresh heartbeat after which a moving device is held, s of the machine."""

BEATS = 4
"""Number of heartbeats that are sent within the deadman's time."""

HELD_UP = 0.012
"""Wait of a thread for a processor, or delay of a timer, from which on the node counts as held up, s."""

DELIVERY = 0.010
"""Time in which a node that was held up still receives messages that have already arrived, s of the machine."""

TURN = 0.001
"""Length of the turns that the node's receiving threads get meanwhile, s of the machine."""


class Scheduling(Protocol):
    """Scheduling of the threads of this process by the machine; see `pcmrs.threads.Threads`."""

    def waited(self) -> float:
        """Return the longest time that one of them has waited for a processor since the last call, s."""

    def pending(self) -> bool:
        """Return True if a thread other than the caller's runs or waits for a processor."""

    def load(self) -> Load:
        """Return the present load of the machine."""


class AlwaysServed:
    """Scheduling of a process that never waits, as in simulated time."""

    def waited(self) -> float:
        return 0.0

    def pending(self) -> bool:
        return False

    def load(self) -> Load:
        return Load(1, 1)


@dataclass(frozen=True, slots=True)
class Silence:
    """Silence of the daemon, as the deadman measured it.

    Attributes:
        lasted: Time since the last sign of life of the daemon's loop, s of the machine.
        held_up: Time for which the node itself got no processor, s; 0 if it was not held up.
    """

    lasted: float
    held_up: float


def beat_period(deadman: float) -> float:
    """Return the time between two heartbeats, of the daemon and of the nodes, s of the machine."""
    return deadman / BEATS


ALWAYS_SERVED = AlwaysServed()


class Deadman:
    """A timer that runs from the last sign of life of the daemon's loop, however late its heartbeat arrived.

    Args:
        limit: Time without a sign of life after which the deadman acts, s of the machine; see `DEADMAN`.
        at_risk: Returns True if anything moves or could fire.
        act: Makes the device safe.
        clock: Clock of the machine.
        saved: Called instead of `act` if the node was held up and a sign of life had arrived meanwhile.
        scheduling: Scheduling of this process.

    Attributes:
        limit: As above.
        late: Number of heartbeats whose sign of life was more than `limit` old when they arrived.
        implausible: Number of heartbeats that were ignored because their time stamps are ahead of all others.
        lateness: Delay of the daemon's messages.
    """

    def __init__(
        self,
        limit: float,
        at_risk: Callable[[], Awaitable[bool]],
        act: Callable[[Silence], Awaitable[None]],
        clock: Clock,
        saved: Callable[[Silence], None] = lambda _: None,
        scheduling: Scheduling = ALWAYS_SERVED,
    ) -> None:
        self.limit = limit
        self.late = self.implausible = 0
        self.lateness = Lateness()
        self._at_risk, self._act, self._clock = at_risk, act, clock
        self._saved, self._scheduling = saved, scheduling
        self._lock = threading.Lock()
        self._started_at = clock.monotonic()
        self._quiet_until = self._started_at
        self._session = ""
        self._ended: set[str] = set()
        self._number = 0
        self._alive = 0.0

    @property
    def session(self) -> str:
        """Session id of the present daemon; empty before the first heartbeat."""
        return self._session

    @property
    def silence(self) -> float:
        """Time since the last sign of life of the daemon's loop, s of the machine."""
        return self._clock.monotonic() - self._last_alive()

    def take_beat(self, beat: Beat) -> None:
        """Take a heartbeat of the daemon; runs in the thread that received it.

        A heartbeat of an earlier session, and a repeated one, are ignored.
        """
        now = self._clock.monotonic()
        with self._lock:
            if beat.session in self._ended:
                return
            if beat.session != self._session:
                self._ended.add(self._session)
                self._session, self._number, self._alive = beat.session, 0, beat.alive
                self.lateness.forget()  # another daemon, perhaps of another start of its machine
            if beat.number <= self._number:
                return
            self._number = beat.number
            if beat.alive > beat.sent or self.lateness.is_ahead(beat.sent, now):
                self.implausible += 1
                return
            self.lateness.update(beat.sent, now)
            self._alive = max(self._alive, beat.alive)
            self.late += self.lateness.delay(beat.alive, now) > self.limit

    def _last_alive(self) -> float:
        """Return the last sign of life by our clock, s; before the first heartbeat, the start of this deadman."""
        with self._lock:
            return max(self._started_at, self.lateness.to_local(self._alive))

    def _due(self) -> float:
        """Return the time at which to act if no newer sign of life arrives, s of our clock."""
        return max(self._last_alive() + self.limit, self._quiet_until)

    async def wait_for_daemon(self) -> bool:
        """Return True as soon as the daemon is alive, and False if it is silent for `limit` from now."""
        end = self._clock.monotonic() + self.limit
        while self.silence > self.limit:
            if self._clock.monotonic() >= end:
                return False
            await self._clock.sleep(TURN)
        return True

    async def run(self) -> None:
        """Watch until cancelled."""
        while True:
            due = self._due()
            await self._clock.sleep(due - self._clock.monotonic())
            waited = max(self._scheduling.waited(), self._clock.monotonic() - due)
            held_up = waited if waited > HELD_UP else 0.0
            if self._clock.monotonic() < self._due():
                continue
            silence = Silence(self.silence, held_up)
            if held_up:
                await self._let_receivers_run()
                if self._clock.monotonic() < self._due():
                    self._saved(silence)
                    continue
            rest = self.limit / 4  # soon: a device may start to move by itself
            if await self._at_risk():
                await self._act(silence)
                rest = self.limit
            self._quiet_until = self._clock.monotonic() + rest

    async def _let_receivers_run(self) -> None:
        """Let the receiving threads run until they have nothing more to do, for `DELIVERY` at most."""
        end = self._clock.monotonic() + DELIVERY
        pending = True
        while pending and self._clock.monotonic() < end:
            await self._clock.sleep(TURN)
            pending = self._scheduling.pending()
