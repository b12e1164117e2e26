"""Handshake of daemon and nodes: a process that has the key asks the daemon which messages are of its present run.

The question contains the session of its sender, which is random and new at each start, and the MAC of the reply covers
the question (ISO/IEC 9798-4, two-pass unilateral authentication). So no recorded reply answers it, and a process that
has just started accepts nothing that was recorded before.
"""

from __future__ import annotations

import asyncio
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
WAITING: Final = 64
"""Number of requests that wait for an answer; one more is refused."""

OnForged = Callable[[str, SealError], None]
"""Takes the relative key and the error of a message that is rejected; called in Zenoh's threads."""


class Handshake:
    """The asking side. One question is sent at a time.

    Args:
        session: Zenoh session.
        key: Absolute key of the daemon's answers.
        seal: Seal of this process, which learns the run from the answer.
        pool: Threads that send the question: a callback of Zenoh must not.
        on_forged: Takes answers that are rejected.
    """

    def __init__(self, session: zenoh.Session, key: str, seal: Seal, pool: Executor, on_forged: OnForged) -> None:
        self._session, self._key, self._seal, self._pool = session, key, seal, pool
        self._on_forged = on_forged
        self._taken = ReplayWindow()
        self._lock = threading.Lock()
        self._asking = False
        self._waiting: list[Callable[[], object]] = []

    def begin(self, then: Callable[[], object] | None = None) -> bool:
        """Ask the daemon, unless a question is pending. From any thread.

        Args:
            then: Called in a thread of the pool as soon as the question has ended, answered or not.

        Returns:
            False if too many wait already; `then` is not called in this case.
        """
        with self._lock:
            if then is not None:
                if len(self._waiting) >= WAITING:
                    return False
                self._waiting.append(then)
            if self._asking:
                return True
            self._asking = True
        self._pool.submit(self._ask)
        return True

    async def ended(self) -> None:
        """Ask the daemon, and return as soon as the question has ended, answered or not."""
        loop = asyncio.get_running_loop()
        end = asyncio.Event()
        self.begin(lambda: loop.call_soon_threadsafe(end.set))
        await end.wait()

    def _ask(self) -> None:
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

        ended = threading.Event()
        with suppress(zenoh.ZError):  # the session is closed
            self._session.get(
                self._key,
                zenoh.handlers.Callback(on_reply, ended.set, indirect=False),
                timeout=QUESTION_TIME,
                attachment=question,
                **TO_ALL_SERVERS,
            )
            # Here, and not in the callback: a session cannot be closed while one of its methods runs.
            ended.wait(2 * QUESTION_TIME)
        with self._lock:
            self._asking = False
            waiting, self._waiting = self._waiting, []
        for then in waiting:
            then()


def answer_questions(session: zenoh.Session, key: str, seal: Seal, on_forged: OnForged) -> Any:
    """Answer the questions of nodes in Zenoh's threads, so that no stall of the event loop delays them.

    Args:
        session: Zenoh session of the daemon.
        key: Absolute key of the answers.
        seal: Seal of the daemon.
        on_forged: Takes questions that are rejected: they get no answer.

    Returns:
        The queryable.
    """
    taken = ReplayWindow()

    def receive(query: zenoh.Query) -> None:
        with query:
            question = attached_to(query)
            try:
                seal.check(question, ("question",), key, payload_of(query), taken)
            except SealError as error:
                on_forged(RUN, error)
                return
            payload = seal.answer()
            query.reply(key, payload, attachment=seal.put("reply", key, payload, question))

    return session.declare_queryable(key, receive, allowed_origin=Locality.REMOTE)
