"""Handshake of daemon and nodes: a process that has the key asks the daemon which messages are of its present run.

The question contains the session of its sender, which is random and new at each start, and the MAC of the reply covers
the question (ISO/IEC 9798-4, two-pass unilateral authentication). So no recorded reply answers it, and a process that
has just started accepts nothing that was recorded before.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import suppress
from typing import Any, Final

import zenoh
from zenoh import Locality

from pcmrs.bus.requests import TO_ALL_SERVERS
from pcmrs.bus.seal import ReplayWindow, Seal
from pcmrs.bus.serving import attached_to, payload_of
from pcmrs.errors import SealError

RUN: Final = "daemon/run"
"""Relative key on which the daemon answers."""
QUESTION_TIME: Final = 2.0
"""Longest wait for the daemon's answer, s."""
ASK_EVERY: Final = 1.0
"""Pause between two questions of a process, s; a restarted daemon may be unknown to it for so long."""
WAITING: Final = 64
"""Number of requests that wait for an answer; one more is refused."""

_log = logging.getLogger(__name__)
_Waiting = list[Callable[[], object]]

OnForged = Callable[[str, SealError], None]
"""Takes the relative key and the error of a message that is rejected; called in Zenoh's threads."""


class Handshake:
    """The asking side. One question is on its way at a time.

    Args:
        session: Zenoh session.
        key: Absolute key of the daemon's answers.
        seal: Seal of this process, which learns the run from the answer.
        pool: Threads that send questions, and call those who wait: a callback of Zenoh must do neither.
        on_forged: Takes answers that are rejected.
    """

    def __init__(self, session: zenoh.Session, key: str, seal: Seal, pool: Executor, on_forged: OnForged) -> None:
        self._session, self._key, self._seal, self._pool = session, key, seal, pool
        self._on_forged = on_forged
        self._taken = ReplayWindow()
        self._lock = threading.Lock()
        self._asking: _Waiting | None = None
        self._next: _Waiting = []

    def begin(self, then: Callable[[], object] | None = None) -> bool:
        """Ask the daemon, unless a question is on its way. From any thread.

        Args:
            then: Called in a thread of the pool as soon as a question that is sent after this call has ended, answered
                or not: the one on its way may have reached an earlier daemon, or none.

        Returns:
            False if too many wait already, or the session is being closed; `then` is not called in these cases.
        """
        with self._lock:
            if then is not None:
                if len(self._next) + len(self._asking or ()) >= WAITING:
                    return False
                self._next.append(then)
            return self._asking is not None or self._start()

    async def ended(self) -> None:
        """Ask the daemon, and return as soon as the question has ended, answered or not."""
        loop = asyncio.get_running_loop()
        end = asyncio.Event()
        if self.begin(lambda: loop.call_soon_threadsafe(end.set)):
            await end.wait()

    async def repeat(self) -> None:
        """Ask again and again: a process that only sends gets no message that shows it a restarted daemon."""
        while True:
            await asyncio.sleep(ASK_EVERY)
            await self.ended()

    def _start(self) -> bool:
        waiting, self._next = self._next, []
        self._asking = waiting
        try:
            self._pool.submit(self._ask, waiting)
        except RuntimeError:  # the pool is shut down
            self._asking = None
            return False
        return True

    def _ask(self, waiting: _Waiting) -> None:
        question = self._seal.put("question", self._key, b"")

        def on_reply(reply: zenoh.Reply) -> None:
            result = reply.result
            if not isinstance(result, zenoh.Sample):
                return  # of the bus itself, at a timeout, or of somebody without the key
            seal, payload = attached_to(result), payload_of(result)
            try:
                self._seal.check(seal, ("reply",), self._key, payload, self._taken, question)
            except SealError as error:
                self._on_forged(RUN, error)
            else:
                self._seal.confirm(seal, payload)
                end()  # now: somebody without the key may keep the query open until its limit

        def end() -> None:
            with suppress(RuntimeError):  # the pool is shut down: nobody waits
                self._pool.submit(self._end, waiting)

        try:
            self._session.get(
                self._key,
                zenoh.handlers.Callback(on_reply, end, indirect=False),
                timeout=QUESTION_TIME,
                attachment=question,
                **TO_ALL_SERVERS,
            )
        except zenoh.ZError:  # the session is closed
            self._end(waiting)

    def _end(self, waiting: _Waiting) -> None:
        with self._lock:
            if self._asking is not waiting:
                return
            self._asking = None
            if self._next:
                self._start()
        for then in waiting:
            try:
                then()
            except Exception:  # the others must not wait permanently
                _log.exception("A message that waited for the run of the daemon was lost.")


def answer_questions(session: zenoh.Session, key: str, seal: Seal, pool: Executor, on_forged: OnForged) -> Any:
    """Answer the questions of nodes outside the event loop, so that no stall of it delays them.

    Args:
        session: Zenoh session of the daemon.
        key: Absolute key of the answers.
        seal: Seal of the daemon.
        pool: Threads that send the answers: a link whose peer does not read blocks its sender.
        on_forged: Takes questions that are rejected: they get no answer.

    Returns:
        The queryable.
    """
    taken = ReplayWindow()

    def receive(query: zenoh.Query) -> None:
        question = attached_to(query)
        try:
            seal.check(question, ("question",), key, payload_of(query), taken)
        except SealError as error:
            with query:
                on_forged(RUN, error)
            return
        with suppress(RuntimeError):  # the pool is shut down
            pool.submit(answer, query, question)

    def answer(query: zenoh.Query, question: bytes) -> None:
        payload = seal.answer()
        with query, suppress(zenoh.ZError):  # the session is closed
            query.reply(key, payload, attachment=seal.put("reply", key, payload, question))

    return session.declare_queryable(key, receive, allowed_origin=Locality.REMOTE)
