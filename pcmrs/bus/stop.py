"""The lane of Stop: a Zenoh session of its own, so that no other traffic is ahead of it."""

from __future__ import annotations

import asyncio
import math
import re
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal

import msgspec
import zenoh

from pcmrs.bus.codec import is_text, pack, pack_text, unpack
from pcmrs.bus.keys import cell_prefix
from pcmrs.bus.serving import payload_of
from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.errors import PayloadError
from pcmrs.messages import Message

PRESS = re.compile(r"[0-9a-f]{32}")
"""Id of one press: random, so that no other press has it."""
LONGEST = 256
"""Bytes of the longest message in which an id is looked for."""
REPEATED = 10.0
"""A message with the id of an earlier one counts as the same press for so long, s; later it is a Stop of its own."""
PRESSES = 256
"""Presses that are remembered; with more in that time, the oldest is forgotten and may stop twice."""


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


class StopLane:
    """Calls `stop(source)` for every put and query on ``stop/<user>``, whatever its payload.

    Messages of one `Press` are one Stop: one that comes late must not stop again what was acknowledged meanwhile. A
    query is answered with the number that `stop` returns; without a number it is left to another process to answer.
    Zenoh's thread hands the call straight to the loop, past the queue of the other messages. Use
    `StopLane.open`.
    """

    def __init__(self, session: zenoh.Session, prefix: str, stop: Callable[[str], int | None]) -> None:
        self._session: Any = session
        self._prefix = prefix
        self._stop = stop
        self._loop = asyncio.get_running_loop()
        self._presses: OrderedDict[tuple[str, str], tuple[float, int | None]] = OrderedDict()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="pcmrs-stop")
        self._receivers: tuple[Any, ...] = (
            session.declare_queryable(f"{prefix}/stop/*", self._on_query),
            session.declare_subscriber(f"{prefix}/stop/*", self._on_put),
        )

    @classmethod
    async def open(cls, settings: BusSettings, stop: Callable[[str], int | None]) -> StopLane:
        """Opens the lane as a client of the router that `settings` names.

        Raises:
            BusError: No router answers.
        """
        own = msgspec.structs.replace(settings, mode="client")
        session = await asyncio.get_running_loop().run_in_executor(None, open_session, own)
        return cls(session, cell_prefix(settings.site, settings.cell), stop)

    async def close(self) -> None:
        """Takes no more stops and closes the session."""
        await self._loop.run_in_executor(self._pool, self._close)
        self._pool.shutdown()

    def _close(self) -> None:
        for receiver in self._receivers:
            receiver.undeclare()
        self._session.close()

    def _on_put(self, sample: zenoh.Sample) -> None:
        press = _press_of(payload_of(sample))
        self._loop.call_soon_threadsafe(self._begin, self._source(str(sample.key_expr)), press)

    def _on_query(self, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        if "*" in key:
            # Somebody looks around, nobody asks for Stop.
            with query:
                return
        self._loop.call_soon_threadsafe(self._answer, query, self._source(key), _press_of(payload_of(query)))

    def _answer(self, query: zenoh.Query, source: str, press: str | None) -> None:
        try:
            number = self._begin(source, press)
        except BaseException:
            with query:
                raise
        stopping = None if number is None else Stopping(source=source, number=number)
        self._loop.run_in_executor(self._pool, _reply, query, stopping)

    def _begin(self, source: str, press: str | None) -> int | None:
        """Stop, unless this press has stopped already; return the Stop's number."""
        now = self._loop.time()
        if press is None:
            return self._stop(source)
        begun, number = self._presses.get((source, press), (-math.inf, None))
        if now - begun > REPEATED:
            number = self._stop(source)
            self._presses[source, press] = now, number
            while len(self._presses) > PRESSES:
                self._presses.popitem(last=False)
        return number

    def _source(self, key: str) -> str:
        return f"bus:{key.removeprefix(f'{self._prefix}/stop/')}"


def _press_of(payload: bytes) -> str | None:
    """Id of the press that a message belongs to; None where it names none."""
    if len(payload) > LONGEST:
        return None  # reading it would hold up Stops behind it
    try:
        press = unpack(payload, Press).id
    except PayloadError:
        return None
    return press if PRESS.fullmatch(press) else None


def _reply(query: zenoh.Query, stopping: Stopping | None) -> None:
    encode = pack_text if is_text(payload_of(query)) else pack
    with query:
        if stopping is not None:
            query.reply(query.key_expr, encode(stopping))
