"""The lane of Stop: its own Zenoh session, so that Stop never waits behind other traffic."""

from __future__ import annotations

import asyncio
import logging
import math
import re
import threading
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec
import zenoh

from pcmrs.bus._fair_queue import FairQueue
from pcmrs.bus.codec import is_text, pack, pack_text, unpack
from pcmrs.bus.keys import MAX_CHUNK, cell_prefix
from pcmrs.bus.serving import payload_of
from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.errors import BusError, PayloadError
from pcmrs.messages import Message
from pcmrs.messages.clipping import shortened

PRESS = re.compile(r"[0-9a-f]{32}")
"""Pattern of the id of one press: random, so that no two presses share it."""
LONGEST_PRESS = 256
"""Longest message in which an id is searched, bytes."""
SAME_PRESS_TIME = 10.0
"""Time for which messages with the same id are one press, s; a later one is a new Stop."""
REMEMBERED_PRESSES = 256
"""Number of presses that are remembered. If more arrive in that time, the oldest is forgotten and may stop twice."""
SOURCES = 32
"""Number of sources that the loop handles by name in one turn; all others are handled together as `OTHERS`."""
OTHERS = "bus:others"
"""Source of the presses beyond the first `SOURCES` sources of one turn."""
WAITING_ANSWERS = 64
"""Number of answers that may wait for one source. One more press still stops, but its query gets no answer."""
ANSWERED_SOURCES = 256
"""Number of sources for which answers may wait; for one more source, a press still stops."""
REACHED_WITHIN = 10.0
"""Time within which messages must reach the lane after it was opened, s."""
PROBE_PERIOD = 0.02
"""Time between two probes of the lane, s."""

_log = logging.getLogger(__name__)


class Press(Message, frozen=True, kw_only=True, omit_defaults=False):
    """One press of Stop that is sent in several messages: the first one that arrives stops, the others repeat it.

    A message without it, as from a command line, is always a new Stop.

    Attributes:
        id: 32 hexadecimal digits, random.
    """

    id: str


class Stopping(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The answer to a query on ``stop/<user>``.

    Attributes:
        source: Source of the Stop.
        number: Number of the Stop.
        stage: ``begun``: the latch is set and the holds are sent. Standstill of the robot is not confirmed yet; the
            snapshot's ``stop`` shows when it is.
    """

    source: str
    number: int
    stage: Literal["begun"] = "begun"


Stop = Callable[[str, int], int | None]
"""Called with source and number of presses; returns the number of the Stop, or None if another process answers."""


@dataclass(slots=True)
class _PendingPresses:
    """Presses of one source that wait for the loop.

    Attributes:
        unnamed: Number of presses without an id.
        named: Ids of the other presses.
        queries: Queries to be answered, each with the id of its press.
    """

    unnamed: int = 0
    named: set[str] = field(default_factory=set)
    queries: list[tuple[zenoh.Query, str | None]] = field(default_factory=list)


class StopLane:
    """Server that calls `stop(source, presses)` for puts and queries on ``stop/<user>``, whatever their payload.

    Messages of one `Press` are one Stop, so that a late one does not stop again after an acknowledgement. A query is
    answered with the number that `stop` returns; without a number, another process has to answer.

    Zenoh's thread only counts presses. The loop is woken once for all of them, ahead of the queue of other messages,
    and handles the presses of one source together. So a source that presses endlessly cannot delay the Stops of others.
    Use `StopLane.open`.
    """

    def __init__(self, session: zenoh.Session, prefix: str, stop: Stop) -> None:
        self._session: Any = session
        self._prefix = prefix
        self._stop = stop
        self._loop = asyncio.get_running_loop()
        self._presses: OrderedDict[tuple[str, str], tuple[float, int | None]] = OrderedDict()
        self._lock = threading.Lock()
        self._waiting: dict[str, _PendingPresses] = {}
        self._replies = StopReplies()
        self._reached = asyncio.Event()
        self._receivers: tuple[Any, ...] = (
            session.declare_subscriber(f"{prefix}/stop/*", self._on_put),
            session.declare_queryable(f"{prefix}/stop/*", self._on_query),  # last: if a probe finds it, both are there
        )

    @classmethod
    async def open(cls, settings: BusSettings, stop: Stop) -> StopLane:
        """Open the lane as a client of a router; see `until_reached` for when the router knows it.

        Args:
            settings: Bus of this process; its router is the one that the lane connects to.
            stop: Called in the event loop for the presses of each source.

        Raises:
            BusError: No router answers.
        """
        own = msgspec.structs.replace(settings, mode="client")
        session = await asyncio.to_thread(open_session, own)
        return cls(session, cell_prefix(settings.site, settings.cell), stop)

    async def until_reached(self, probe: Callable[[], Awaitable[object]]) -> None:
        """Wait until the router delivers messages to this lane.

        Args:
            probe: Sends a query on ``stop/*`` from a session of the router.

        Raises:
            BusError: None arrives within `REACHED_WITHIN`.
        """
        try:
            async with asyncio.timeout(REACHED_WITHIN):
                while not self._reached.is_set():
                    await probe()
                    with suppress(TimeoutError):
                        await asyncio.wait_for(self._reached.wait(), PROBE_PERIOD)
        except TimeoutError:
            text = f"The daemon's own router delivers no Stop within {REACHED_WITHIN:g} s: restart the daemon."
            raise BusError(text) from None

    async def close(self) -> None:
        """Stop taking presses, answer those that were taken, and close the session."""
        await asyncio.to_thread(self.end)

    def end(self) -> None:
        """As `close`, but block until then."""
        for receiver in self._receivers:
            receiver.undeclare()
        self._replies.close()
        self._session.close()

    def _on_put(self, sample: zenoh.Sample) -> None:
        self._count_press(str(sample.key_expr), _press_id(payload_of(sample)), None)

    def _on_query(self, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        if "*" in key:
            # A probe, not a Stop.
            self._loop.call_soon_threadsafe(self._reached.set)
            _drop(query)
        else:
            self._count_press(key, _press_id(payload_of(query)), query)

    def _count_press(self, key: str, press: str | None, query: zenoh.Query | None) -> None:
        """Count a press; runs in Zenoh's thread."""
        # Every name stops, also one that is longer than any user's, but it must not fill the journal.
        name = key.removeprefix(f"{self._prefix}/stop/")
        source = f"bus:{shortened(name, MAX_CHUNK)}"
        with self._lock:
            if not self._waiting:
                self._loop.call_soon_threadsafe(self._handle_presses)
            if source not in self._waiting and len(self._waiting) >= SOURCES:
                source = OTHERS
            waiting = self._waiting.setdefault(source, _PendingPresses())
            if press is None or len(waiting.named) >= REMEMBERED_PRESSES:
                waiting.unnamed += 1
            else:
                waiting.named.add(press)
            if query is not None and len(waiting.queries) < WAITING_ANSWERS:
                waiting.queries.append((query, press))
                query = None
        if query is not None:
            _drop(query)

    def _handle_presses(self) -> None:
        """Stop for all sources that have pressed since the last turn; runs in the loop."""
        with self._lock:
            taken, self._waiting = self._waiting, {}
        for source, waiting in taken.items():
            try:
                self._stop_and_answer(source, waiting)
            except Exception as error:
                for query, _ in waiting.queries:
                    _drop(query)
                self._loop.call_exception_handler({"message": f"Stop by {source} failed", "exception": error})

    def _stop_and_answer(self, source: str, waiting: _PendingPresses) -> None:
        """Stop, unless each of these presses has stopped already, and answer the queries."""
        now = self._loop.time()
        earlier = {press: self._presses.get((source, press), (-math.inf, None)) for press in waiting.named}
        numbers = {press: number for press, (since, number) in earlier.items() if now - since <= SAME_PRESS_TIME}
        fresh = waiting.named - numbers.keys()
        number: int | None = None
        if fresh or waiting.unnamed:
            number = self._stop(source, waiting.unnamed + len(fresh))
        for each in fresh:
            numbers[each] = number
            self._presses[source, each] = now, number
            while len(self._presses) > REMEMBERED_PRESSES:
                self._presses.popitem(last=False)
        for query, press in waiting.queries:
            answer = numbers.get(press, number) if press is not None else number
            self._replies.add(source, query, None if answer is None else Stopping(source=source, number=answer))


class StopReplies:
    """Sender of the answers to Stops: own thread, in turn over the sources; no source waits behind a flood."""

    def __init__(self) -> None:
        self._waiting: FairQueue[tuple[zenoh.Query, Stopping | None]] = FairQueue(WAITING_ANSWERS, ANSWERED_SOURCES)
        self._filled = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="pcmrs-stop", daemon=True)
        self._thread.start()

    def add(self, source: str, query: zenoh.Query, stopping: Stopping | None) -> None:
        """Queue an answer; the query is dropped if too many answers wait.

        Args:
            source: Source of the press.
            query: Query to be answered.
            stopping: The answer; None to leave the query to another process.
        """
        with self._filled:
            if self._waiting.put(source, (query, stopping)):
                self._filled.notify()
                return
        _drop(query)

    def close(self) -> None:
        """Wait until all queued answers are sent."""
        with self._filled:
            self._closed = True
            self._filled.notify()
        self._thread.join()

    def _run(self) -> None:
        while (answer := self._next()) is not None:
            try:
                _reply(*answer)
            except Exception:
                _log.exception("The answer to a Stop cannot be sent")  # go on: other clients wait for theirs

    def _next(self) -> tuple[zenoh.Query, Stopping | None] | None:
        with self._filled:
            self._filled.wait_for(lambda: self._waiting or self._closed)
            return self._waiting.take()


def _press_id(payload: bytes) -> str | None:
    """Return the id of the press that a message belongs to; None if it has none."""
    if not payload or len(payload) > LONGEST_PRESS:
        return None  # decoding a long one would delay the Stops behind it
    try:
        press = unpack(payload, Press).id
    except PayloadError:
        return None
    return press if PRESS.fullmatch(press) else None


def _drop(query: zenoh.Query) -> None:
    """End a query without a reply."""
    with query:
        return


def _reply(query: zenoh.Query, stopping: Stopping | None) -> None:
    encode = pack_text if is_text(payload_of(query)) else pack
    with query:
        if stopping is not None:
            query.reply(query.key_expr, encode(stopping))
