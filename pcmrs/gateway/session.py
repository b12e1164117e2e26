"""One peer of one link: its order of commands, its acknowledgements and its verdict replies."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import structlog

from pcmrs.clock import Clock
from pcmrs.errors import PcmrsError, RefusalError
from pcmrs.gateway.actions import Actions, Job
from pcmrs.gateway.commands import Action, Second
from pcmrs.gateway.grammar import Request
from pcmrs.gateway.memory import Memory
from pcmrs.gateway.outcome import NO_DATA, Outcome
from pcmrs.gateway.tasks import Tasks

ACKNOWLEDGEMENT = "ack"
SECOND_WITHIN = 0.35
"""Seconds from the acknowledgement to the second datagram: clients wait 0.4 s."""
MAX_WAITING = 64
"""Commands of one peer that wait or run; more are refused."""
QUEUE_FULL = "queue_full"

_log = structlog.get_logger(__name__)

Send = Callable[[str], None]
Queued = tuple[Request, Job, "asyncio.Future[Outcome]"]


@dataclass(frozen=True, slots=True)
class Answer:
    """Where answers to one datagram go.

    Attributes:
        verdict: To the sender's address.
        acknowledge: To the link's reply port; None on a link that does not acknowledge.
    """

    verdict: Send
    acknowledge: Send | None


class Session:
    """Commands without an id are acknowledged at once and run one after the other; those with one run as they come.

    Args:
        actions: What the commands do.
        clock: The machine's clock.
        tasks: Owns what runs.
        memory: Remembers the outcomes of commands with an id, of all peers.
        on_overflow: Called when a command is refused because too many wait.
    """

    def __init__(
        self, actions: Actions, clock: Clock, tasks: Tasks, memory: Memory, on_overflow: Callable[[], None]
    ) -> None:
        self._actions = actions
        self._clock = clock
        self._tasks = tasks
        self._memory = memory
        self._on_overflow = on_overflow
        self._queue: deque[Queued] = deque()
        self._draining = False
        self._running = 0

    @property
    def idle(self) -> bool:
        """Whether nothing waits or runs."""
        return not self._queue and self._running == 0

    def receive(self, request: Request, answer: Answer, refusal: RefusalError | None = None) -> None:
        """Begins a command, or rejects it with `refusal`, unless it was begun before; never waits."""
        if request.id is not None:
            self._receive_identified(request, request.id, answer.verdict, refusal)
            return
        if answer.acknowledge is not None:
            answer.acknowledge(ACKNOWLEDGEMENT)
        ended = self._begin(request, refusal)
        ended.add_done_callback(lambda done: _report(request, done))
        if request.spec.second is not None and answer.acknowledge is not None:
            self._tasks.spawn(self._send_second(request.spec.second, ended, answer.acknowledge))

    def halt(self) -> None:
        """Rejects what waits and ends what has steps to come, as Stop demands."""
        self._actions.halt()
        while self._queue:
            request, _, ended = self._queue.popleft()
            ended.set_result(self._actions.rejected(request, "stopped"))

    def _receive_identified(
        self, request: Request, client_id: str, verdict: Send, refusal: RefusalError | None
    ) -> None:
        # Stop is honoured every time, whatever its id.
        repeatable = request.spec.action is Action.STOP
        ended = None if repeatable else self._memory.recall(self._actions.source, client_id)
        if ended is not None and not ended.done():
            return  # attached: the reply under way goes to this same sender
        if ended is None:
            ended = self._begin(request, refusal)
            self._memory.keep(self._actions.source, client_id, ended)
        ended.add_done_callback(lambda done: None if done.cancelled() else verdict(done.result().reply(client_id)))

    def _begin(self, request: Request, refusal: RefusalError | None) -> asyncio.Future[Outcome]:
        prepared = self._actions.prepare(request) if refusal is None else self._actions.deny(request, refusal)
        ended: asyncio.Future[Outcome] = asyncio.get_running_loop().create_future()
        if isinstance(prepared, Outcome):
            ended.set_result(prepared)
        elif request.spec.action is Action.STOP:
            self._tasks.spawn(self._run(request, prepared, ended))
        elif len(self._queue) + self._running >= MAX_WAITING:
            self._on_overflow()
            ended.set_result(self._actions.rejected(request, QUEUE_FULL))
        elif request.id is not None:
            self._tasks.spawn(self._run(request, prepared, ended))
        else:
            self._enqueue((request, prepared, ended))
        return ended

    def _enqueue(self, queued: Queued) -> None:
        self._queue.append(queued)
        if not self._draining:
            self._draining = True
            self._tasks.spawn(self._drain())

    async def _drain(self) -> None:
        while self._queue:
            await self._run(*self._queue.popleft())
        self._draining = False

    async def _run(self, request: Request, job: Job, ended: asyncio.Future[Outcome]) -> None:
        self._running += 1
        try:
            ended.set_result(await self._perform(request, job))
        finally:
            self._running -= 1

    async def _perform(self, request: Request, job: Job) -> Outcome:
        """Every way a job can end, as an outcome: a client must not wait for ever."""
        try:
            return await job()
        except RefusalError as refusal:
            return self._actions.refused(request, refusal)
        except PcmrsError as error:
            return self._actions.failed(request, error.code)
        except Exception:
            _log.exception("command_broke", command=request.spec.name)
            return self._actions.failed(request, "internal_error")

    async def _send_second(self, kind: Second, ended: asyncio.Future[Outcome], send: Send) -> None:
        """A late result is never sent: the client would take it for its next acknowledgement."""
        try:
            async with self._clock.timeout(SECOND_WITHIN):
                text = (await asyncio.shield(ended)).second(kind)
        except TimeoutError:
            text = NO_DATA
        send(text)


def _report(request: Request, ended: asyncio.Future[Outcome]) -> None:
    """Clients without verdict replies never learn of a refusal, so the log has to tell it."""
    if not ended.cancelled() and (outcome := ended.result()).decision != "accepted":
        _log.warning(
            "command_refused",
            command=request.spec.name,
            decision=outcome.decision,
            branch=outcome.branch,
            state=outcome.state,
            reason=outcome.reason,
        )
