"""The deadman of a device node: what moves is made safe when nothing fresh is heard of the daemon.

Events of a node that did not hear the daemon: what they mean, and what the machine had to do then.
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
    """The node has made its device safe by itself: danger.

    Args:
        device: That moved, or could have fired.
        silence: Of the daemon.
        limit: Of the deadman, s of the machine.
        load: Of the node's machine, just afterwards.
    """
    text = f"The node of the {device} has made it safe by itself: it had not heard the daemon for "
    text += f"{silence.lasted * 1e3:.0f} ms, limit {limit * 1e3:.0f} ms.{_why(silence, load)} "
    text += "Nothing goes on by itself: look, and acknowledge."
    fields = {"silence": silence.lasted, "limit": limit, **_fields(silence, load)}
    return DeviceEvent(device=device, code="daemon_silent", text=text, danger=True, fields=fields)


def node_held_up(device: str, silence: Silence, load: Load) -> DeviceEvent:
    """The node itself was not served by its machine, and so could not hear the daemon in time.

    Args:
        device: That it watches over.
        silence: As it seemed before the node had taken what had arrived meanwhile.
        load: Of the node's machine, just afterwards.
    """
    text = f"The node of the {device} was held up.{_why(silence, load)} pcmrs-serve says at its start what it lacks "
    text += "to go ahead of other programs; stop some of those."
    return DeviceEvent(device=device, code="node_held_up", text=text, fields=_fields(silence, load))


def _why(silence: Silence, load: Load) -> str:
    if silence.held_up:
        return f" The node had waited {silence.held_up * 1e3:.0f} ms for a processor: {load}."
    return f" The machine is overloaded: {load}." if load.running > load.processors else ""


def _fields(silence: Silence, load: Load) -> dict[str, float]:
    return {"held_up": silence.held_up, "running": load.running, "processors": load.processors}


DEADMAN = 0.1
"""Without a fresh heartbeat for so long what moves is held, s of the machine, unless configured otherwise."""

BEATS = 4
"""Heartbeats are sent so often within the deadman's time."""

HELD_UP = 0.012
"""A node of which a thread has waited so long for a processor, or whose timer was so late, was held up itself, s."""

DELIVERY = 0.010
"""What has already arrived at a node that was held up is taken within this, or not any more, s of the machine."""

TURN = 0.001
"""Threads of the node are given turns of this length meanwhile, s of the machine."""


class Scheduling(Protocol):
    """How the threads of this process are served by the machine; see `pcmrs.threads.Threads`."""

    def waited(self) -> float:
        """The longest that one of them has waited for a processor since the last call, s."""

    def pending(self) -> bool:
        """Whether another thread than the caller's has something to do."""

    def load(self) -> Load:
        """What the machine has to do now."""


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
    """Why the deadman acts.

    Attributes:
        lasted: Since the last sign of life of the daemon's loop, s of the machine.
        held_up: The node itself was not served by the machine for so long meanwhile, s; 0 where it was.
    """

    lasted: float
    held_up: float


def beat_period(deadman: float) -> float:
    """Time between two heartbeats, of the daemon and of the nodes, s of the machine."""
    return deadman / BEATS


ALWAYS_SERVED = AlwaysServed()


class Deadman:
    """A timer that runs from the last sign of life of the daemon's loop, however late that became known.

    Args:
        limit: See `DEADMAN`.
        at_risk: Whether anything moves or could fire.
        act: Makes that safe.
        clock: The machine's.
        saved: Called when the node was held up and a sign of life had arrived meanwhile: it does not act.
        scheduling: Of this process.

    Attributes:
        limit: See `DEADMAN`.
        late: Heartbeats whose sign of life was more than `limit` old when they came.
        implausible: Heartbeats that say nothing, since their stamps lie ahead of those of all others.
        lateness: Of what the daemon sends.
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
        self._begun = clock.monotonic()
        self._rests_until = self._begun
        self._session = ""
        self._ended: set[str] = set()
        self._number = 0
        self._alive = 0.0

    @property
    def session(self) -> str:
        """Of the daemon that is heard; empty before the first beat."""
        return self._session

    @property
    def silence(self) -> float:
        """Time since the last sign of life of the daemon's loop, s of the machine."""
        return self._clock.monotonic() - self._last_alive()

    def hear(self, beat: Beat) -> None:
        """Takes a heartbeat of the daemon, in the thread that has received it.

        Of an earlier session, or again, it says nothing.
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
            self.lateness.hear(beat.sent, now)
            self._alive = max(self._alive, beat.alive)
            self.late += self.lateness.of(beat.alive, now) > self.limit

    def _last_alive(self) -> float:
        """By our clock; before the first beat, when this began."""
        with self._lock:
            return max(self._begun, self.lateness.here(self._alive))

    def _due(self) -> float:
        """When to act unless another sign of life becomes known."""
        return max(self._last_alive() + self.limit, self._rests_until)

    async def heard(self) -> bool:
        """Whether the daemon is there: at once, or within `limit` from now."""
        end = self._clock.monotonic() + self.limit
        while self.silence > self.limit:
            if self._clock.monotonic() >= end:
                return False
            await self._clock.sleep(TURN)
        return True

    async def run(self) -> None:
        """Watches until cancelled."""
        while True:
            due = self._due()
            await self._clock.sleep(due - self._clock.monotonic())
            waited = max(self._scheduling.waited(), self._clock.monotonic() - due)
            held_up = waited if waited > HELD_UP else 0.0
            if self._clock.monotonic() < self._due():
                continue
            silence = Silence(self.silence, held_up)
            if held_up:
                await self._take_what_has_arrived()
                if self._clock.monotonic() < self._due():
                    self._saved(silence)
                    continue
            rest = self.limit / 4  # soon: something may begin to move unasked
            if await self._at_risk():
                await self._act(Silence(self.silence, held_up))
                rest = self.limit
            self._rests_until = self._clock.monotonic() + rest

    async def _take_what_has_arrived(self) -> None:
        """Lets the threads that receive run until they have nothing more to do, and waits for nothing else."""
        end = self._clock.monotonic() + DELIVERY
        pending = True
        while pending and self._clock.monotonic() < end:
            await self._clock.sleep(TURN)
            pending = self._scheduling.pending()
