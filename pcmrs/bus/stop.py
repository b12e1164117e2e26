"""The lane of Stop: a Zenoh session of its own, so that no other traffic is ahead of it."""

from __future__ import annotations

import asyncio
import logging
import math
import re
import threading
from collections import OrderedDict, deque
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec
import zenoh

from pcmrs.bus.codec import is_text, pack, pack_text, unpack
from pcmrs.bus.keys import cell_prefix
from pcmrs.bus.serving import payload_of
from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.errors import BusError, PayloadError
from pcmrs.messages import Message

PRESS = re.compile(r"[0-9a-f]{32}")
"""Id of one press: random, so that no other press has it."""
LONGEST = 256
"""Bytes of the longest message in which an id is looked for."""
REPEATED = 10.0
"""A message with the id of an earlier one counts as the same press for so long, s; later it is a Stop of its own."""
PRESSES = 256
"""Presses that are remembered; with more in that time, the oldest is forgotten and may stop twice."""
SOURCES = 32
"""Sources that the loop is told of in one turn; further ones are told as one, `OTHERS`."""
OTHERS = "bus:others"
ANSWERED = 64
"""Answers that wait for one source; one more is not sent, though it was a Stop: its asker learns nothing."""
REACHED_WITHIN = 10.0
"""A lane that its router has not found by then does not open, s."""
LOOKED_EVERY = 0.02
"""Between two looks for it, s."""

_log = logging.getLogger(__name__)


class Press(Message, frozen=True, kw_only=True, omit_defaults=False):
    """One press of Stop, sent by more than one way: whichever message comes first stops, and the others repeat it.

    Without it, as from a command line, each message is a Stop of its own.

    Attributes:
        id: 32 hexadecimal digits, random.
    """

    id: str


class Stopping(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The answer to a query on ``stop/<user>``.

    Attributes:
        source: Who has stopped.
        number: Of the Stop.
        stage: ``begun``: the latch is set and the holds are sent. That the robot stands is not confirmed yet: the
            snapshot's ``stop`` says when it is.
    """

    source: str
    number: int
    stage: Literal["begun"] = "begun"


Stop = Callable[[str, int], int | None]
"""Stops for a source that has pressed so often; the number of the Stop, or None where another process answers."""


@dataclass(slots=True)
class _Waiting:
    """Presses of one source that wait for the loop.

    Attributes:
        unnamed: How many name no `Press`.
        named: Ids of those that do.
        queries: To be answered, each with its id.
    """

    unnamed: int = 0
    named: set[str] = field(default_factory=set)
    queries: list[tuple[zenoh.Query, str | None]] = field(default_factory=list)


class StopLane:
    """Calls `stop(source, presses)` for the puts and queries on ``stop/<user>``, whatever their payload.

    Messages of one `Press` are one Stop: one that comes late must not stop again what was acknowledged meanwhile. A
    query is answered with the number that `stop` returns; without a number it is left to another process to answer.

    Zenoh's thread only counts: the loop is woken once for all that has come, past the queue of the other messages, and
    takes the presses of one source together. So nobody who presses without end keeps the loop from the Stops of others.
    Use `StopLane.open`.
    """

    def __init__(self, session: zenoh.Session, prefix: str, stop: Stop) -> None:
        self._session: Any = session
        self._prefix = prefix
        self._stop = stop
        self._loop = asyncio.get_running_loop()
        self._presses: OrderedDict[tuple[str, str], tuple[float, int | None]] = OrderedDict()
        self._lock = threading.Lock()
        self._waiting: dict[str, _Waiting] = {}
        self._replies = Replies()
        self._reached = asyncio.Event()
        self._receivers: tuple[Any, ...] = (
            session.declare_subscriber(f"{prefix}/stop/*", self._on_put),
            session.declare_queryable(f"{prefix}/stop/*", self._on_query),  # last: who finds it finds both
        )

    @classmethod
    async def open(cls, settings: BusSettings, stop: Stop) -> StopLane:
        """Opens the lane as a client of the router that `settings` names, which learns of it a moment later.

        Raises:
            BusError: No router answers.
        """
        own = msgspec.structs.replace(settings, mode="client")
        session = await asyncio.to_thread(open_session, own)
        return cls(session, cell_prefix(settings.site, settings.cell), stop)

    async def until_reached(self, look: Callable[[], Awaitable[object]]) -> None:
        """Returns when the router brings messages to this lane.

        Args:
            look: Looks around on ``stop/*`` from a session of the router.

        Raises:
            BusError: It brings none within `REACHED_WITHIN`.
        """
        try:
            async with asyncio.timeout(REACHED_WITHIN):
                while not self._reached.is_set():
                    await look()
                    with suppress(TimeoutError):
                        await asyncio.wait_for(self._reached.wait(), LOOKED_EVERY)
        except TimeoutError:
            text = f"The daemon's own router brings it no Stop after {REACHED_WITHIN:g} s: start the daemon again."
            raise BusError(text) from None

    async def close(self) -> None:
        """Takes no more stops, answers those it has taken, and closes the session."""
        await asyncio.to_thread(self._close)

    def _close(self) -> None:
        for receiver in self._receivers:
            receiver.undeclare()
        self._replies.close()
        self._session.close()

    def _on_put(self, sample: zenoh.Sample) -> None:
        self._wait(str(sample.key_expr), _press_of(payload_of(sample)), None)

    def _on_query(self, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        if "*" in key:
            # Somebody looks around, nobody asks for Stop.
            self._loop.call_soon_threadsafe(self._reached.set)
            _drop(query)
        else:
            self._wait(key, _press_of(payload_of(query)), query)

    def _wait(self, key: str, press: str | None, query: zenoh.Query | None) -> None:
        """Counts a press, in Zenoh's thread."""
        source = f"bus:{key.removeprefix(f'{self._prefix}/stop/')}"
        with self._lock:
            if not self._waiting:
                self._loop.call_soon_threadsafe(self._take)
            if source not in self._waiting and len(self._waiting) >= SOURCES:
                source = OTHERS
            waiting = self._waiting.setdefault(source, _Waiting())
            if press is None or len(waiting.named) >= PRESSES:
                waiting.unnamed += 1
            else:
                waiting.named.add(press)
            if query is not None and len(waiting.queries) < ANSWERED:
                waiting.queries.append((query, press))
                query = None
        if query is not None:
            _drop(query)

    def _take(self) -> None:
        """Stops for everybody who has pressed since the last turn, in the loop."""
        with self._lock:
            taken, self._waiting = self._waiting, {}
        for source, waiting in taken.items():
            try:
                self._begin(source, waiting)
            except Exception as error:
                for query, _ in waiting.queries:
                    _drop(query)
                self._loop.call_exception_handler({"message": f"Stop by {source} failed", "exception": error})

    def _begin(self, source: str, waiting: _Waiting) -> None:
        """Stop, unless each of these presses has stopped already, and answer."""
        now = self._loop.time()
        earlier = {press: self._presses.get((source, press), (-math.inf, None)) for press in waiting.named}
        numbers = {press: number for press, (begun, number) in earlier.items() if now - begun <= REPEATED}
        fresh = waiting.named - numbers.keys()
        number: int | None = None
        if fresh or waiting.unnamed:
            number = self._stop(source, waiting.unnamed + len(fresh))
        for each in fresh:
            numbers[each] = number
            self._presses[source, each] = now, number
            while len(self._presses) > PRESSES:
                self._presses.popitem(last=False)
        for query, press in waiting.queries:
            answer = numbers.get(press, number) if press is not None else number
            self._replies.add(source, query, None if answer is None else Stopping(source=source, number=answer))


class Replies:
    """Sends the answers to Stops in a thread of its own, one source after the other: nobody waits behind a flood."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[tuple[zenoh.Query, Stopping | None]]] = {}
        self._filled = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="pcmrs-stop", daemon=True)
        self._thread.start()

    def add(self, source: str, query: zenoh.Query, stopping: Stopping | None) -> None:
        """Has a query answered, or left to another process; of a source with too many it is dropped."""
        with self._filled:
            waiting = self._waiting.setdefault(source, deque())
            if len(waiting) < ANSWERED:
                waiting.append((query, stopping))
                self._filled.notify()
                return
        _drop(query)

    def close(self) -> None:
        """Returns when everything is answered."""
        with self._filled:
            self._closed = True
            self._filled.notify()
        self._thread.join()

    def _run(self) -> None:
        while (answer := self._next()) is not None:
            try:
                _reply(*answer)
            except Exception:
                _log.exception("The answer to a Stop cannot be sent")  # the others are waited for

    def _next(self) -> tuple[zenoh.Query, Stopping | None] | None:
        with self._filled:
            self._filled.wait_for(lambda: self._waiting or self._closed)
            if not self._waiting:
                return None
            source = next(iter(self._waiting))
            waiting = self._waiting.pop(source)
            answer = waiting.popleft()
            if waiting:
                self._waiting[source] = waiting  # at the end: the others come first
            return answer


def _press_of(payload: bytes) -> str | None:
    """Id of the press that a message belongs to; None where it names none."""
    if not payload or len(payload) > LONGEST:
        return None  # reading a long one would hold up Stops behind it
    try:
        press = unpack(payload, Press).id
    except PayloadError:
        return None
    return press if PRESS.fullmatch(press) else None


def _drop(query: zenoh.Query) -> None:
    """Ends a query without an answer."""
    with query:
        return


def _reply(query: zenoh.Query, stopping: Stopping | None) -> None:
    encode = pack_text if is_text(payload_of(query)) else pack
    with query:
        if stopping is not None:
            query.reply(query.key_expr, encode(stopping))
