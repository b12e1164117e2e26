"""Session of one peer of one link: order of its commands, acknowledgements and verdict replies."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import structlog

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.dispatcher.verdict_cache import CommandCache
from pcmrs.errors import PcmrsError, RefusalError
from pcmrs.gateway.commands import Action, Second
from pcmrs.gateway.grammar import NO_DATA, CommandOutcome, StringCommand
from pcmrs.gateway.handlers import CommandHandlers, Job
from pcmrs.messages import Command

ACKNOWLEDGEMENT = "ack"
SECOND_WITHIN = 0.35
"""Limit of a second datagram's wait for its result, s; then it says that there is none."""
SECOND_BEFORE = 0.38
"""Time after the acknowledgement from which no second datagram is sent, s: clients wait 0.4 s for its arrival."""
BEGIN_WITHIN = 0.1
"""Limit from the arrival of a command that moves to its checks, s; later it is refused."""
MAX_WAITING = 64
"""Limit of commands of one peer that wait or run; more are refused."""
QUEUE_FULL = "queue_full"
BUSY = "busy"

_log = structlog.get_logger(__name__)

Send = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class ReplyChannel:
    """Channel of the answers to one datagram.

    Attributes:
        verdict: Sends to the sender's address.
        acknowledge: Sends to the link's reply port; None on a link that does not acknowledge.
    """

    verdict: Send
    acknowledge: Send | None


@dataclass(eq=False, slots=True)
class Turn:
    """A command that runs, or waits for its turn.

    Attributes:
        job: The work.
        ended: Its outcome, done or to come.
        arrived: Time of its arrival, s of the machine's clock.
        stops: Number of halts of the session until then.
    """

    request: StringCommand
    job: Job
    ended: asyncio.Future[CommandOutcome]
    arrived: float
    stops: int


@dataclass(frozen=True, slots=True)
class IdentifiedCommand:
    """A command with an id, which a client may send again.

    Attributes:
        request: The command.
        parts: Parts of the plan that it ends; None for others.
        ended: Its outcome, done or to come.
    """

    request: StringCommand
    parts: object
    ended: asyncio.Future[CommandOutcome]

    def done(self) -> bool:
        """Return whether the command has ended."""
        return self.ended.done()

    def repeated_by(self, request: StringCommand, parts: object) -> bool:
        """Return whether another command with this id is the same one, and not another one that reuses the id.

        Args:
            request: The other command.
            parts: Parts of the plan that it would end, if they were sent again.
        """
        return request.repeats(self.request) and parts in (None, self.parts)


class PeerSession:
    """Session of one peer. Commands without an id are acknowledged at once and start in order; others start at once.

    No command waits for the end of a motion: later commands run beside it, and the daemon decides on them. A motion
    waits for earlier commands, such as its plan, for at most `BEGIN_WITHIN`. A motion that arrives while another one of
    this peer runs or waits is refused.

    Args:
        actions: Handlers of the commands.
        clock: The machine's clock.
        tasks: Owner of its tasks.
        outcomes: Outcomes of commands with an id, of all peers.
        on_overflow: Called if a command is refused because too many wait.
    """

    def __init__(
        self,
        actions: CommandHandlers,
        clock: Clock,
        tasks: BackgroundTasks,
        outcomes: CommandCache[IdentifiedCommand],
        on_overflow: Callable[[], None],
    ) -> None:
        self._actions = actions
        self._clock = clock
        self._tasks = tasks
        self._outcomes = outcomes
        self._on_overflow = on_overflow
        self._queue: deque[Turn] = deque()
        self._draining = False
        self._running = 0
        self._stops = 0
        self._motion: asyncio.Future[CommandOutcome] | None = None

    @property
    def idle(self) -> bool:
        """True if no command waits or runs."""
        return not self._queue and self._running == 0

    def receive(
        self, request: StringCommand, answer: ReplyChannel, arrived: float, refusal: RefusalError | None = None
    ) -> None:
        """Begin a command, or reject it with `refusal`, unless it repeats an earlier one; never waits.

        Args:
            request: The command.
            answer: Channel for answers.
            arrived: Time of its arrival, s of the machine's clock.
            refusal: Why it is refused already; None if it is not.
        """
        if request.id is not None:
            self._receive_identified(request, request.id, answer.verdict, arrived, refusal)
            return
        acknowledged = self._clock.monotonic()
        if answer.acknowledge is not None:
            answer.acknowledge(ACKNOWLEDGEMENT)
        ended = self._begin(request, arrived, refusal)
        ended.add_done_callback(lambda done: _report(request, done))
        if request.spec.second is not None and answer.acknowledge is not None:
            self._tasks.spawn(self._send_second(request.spec.second, ended, answer.acknowledge, acknowledged))

    def halt(self) -> None:
        """Reject waiting commands, and end those with further steps, because of Stop."""
        self._stops += 1
        self._actions.halt()
        while self._queue:
            turn = self._queue.popleft()
            turn.ended.set_result(self._actions.rejected(turn.request, "stopped"))

    def note_end(self, command: Command) -> None:
        """Note that an operation of this peer has been accepted just now."""
        self._actions.note_end(command)

    def _receive_identified(
        self, request: StringCommand, client_id: str, verdict: Send, arrived: float, refusal: RefusalError | None
    ) -> None:
        # Stop is performed each time, whatever its id.
        known = None
        if request.spec.action is not Action.STOP:
            known = self._outcomes.get(self._actions.source, client_id)
        parts = self._actions.collected(request)
        if known is not None and not known.repeated_by(request, parts):
            verdict(self._actions.deny_reused(request, known.request).reply(client_id))
            return
        if known is None:
            known = IdentifiedCommand(request, parts, self._begin(request, arrived, refusal))
            self._outcomes.put(self._actions.source, client_id, known)
        elif not known.done():
            return  # attached: the reply to come goes to this same sender
        ended = known.ended
        ended.add_done_callback(lambda done: None if done.cancelled() else verdict(done.result().reply(client_id)))

    def _begin(
        self, request: StringCommand, arrived: float, refusal: RefusalError | None
    ) -> asyncio.Future[CommandOutcome]:
        prepared = self._actions.prepare(request, arrived) if refusal is None else self._actions.deny(request, refusal)
        ended: asyncio.Future[CommandOutcome] = asyncio.get_running_loop().create_future()
        if isinstance(prepared, CommandOutcome):
            ended.set_result(prepared)
            return ended
        turn = Turn(request, prepared, ended, arrived, self._stops)
        if request.spec.action is Action.STOP:
            self._start(turn)
        elif request.spec.moves and self._motion is not None and not self._motion.done():
            text = (
                "another motion of the same client runs or waits, and motions are not queued; send it when that ended."
            )
            ended.set_result(self._actions.rejected(request, BUSY, text))
        elif len(self._queue) + self._running >= MAX_WAITING:
            self._on_overflow()
            ended.set_result(self._actions.rejected(request, QUEUE_FULL))
        elif request.spec.action is Action.KEEP_JOINTS:
            self._start(turn)  # the present joints are meant, not those after the commands before
        else:
            self._motion = ended if request.spec.moves else self._motion
            self._take_turn(turn)
        return ended

    def _take_turn(self, turn: Turn) -> None:
        if turn.request.id is not None:
            self._start(turn)
            return
        self._queue.append(turn)
        if not self._draining:
            self._draining = True
            self._tasks.spawn(self._drain())
        elif turn.request.spec.moves:
            self._tasks.spawn(self._give_up(turn))

    async def _drain(self) -> None:
        while self._queue:
            turn = self._queue.popleft()
            # Each is its own task, so that they begin in this order although none waits for the end of a motion.
            running = self._start(turn)
            if not turn.request.spec.moves:
                await asyncio.wait([running])
        self._draining = False

    async def _give_up(self, turn: Turn) -> None:
        """Refuse a motion that still waits after its time limit."""
        with suppress(TimeoutError):
            async with self._clock.timeout(BEGIN_WITHIN):
                await asyncio.wait([turn.ended])
        if turn in self._queue:
            self._queue.remove(turn)
            text = f"an earlier command still runs after {BEGIN_WITHIN:g} s; send it when that has ended."
            turn.ended.set_result(self._actions.rejected(turn.request, BUSY, text))

    def _start(self, turn: Turn) -> asyncio.Task[None]:
        self._running += 1
        return self._tasks.spawn(self._run(turn))

    async def _run(self, turn: Turn) -> None:
        try:
            turn.ended.set_result(self._too_late(turn) or await self._perform(turn.request, turn.job))
        finally:
            self._running -= 1

    def _too_late(self, turn: Turn) -> CommandOutcome | None:
        """Refusal of a command that must not begin any more, because of Stop or a stalled loop; None if it may."""
        request = turn.request
        if turn.stops != self._stops and request.spec.action is not Action.STOP:
            return self._actions.rejected(request, "stopped")
        waited = self._clock.monotonic() - turn.arrived
        if request.spec.moves and waited > BEGIN_WITHIN:
            text = f"it arrived {waited:.3f} s ago and has not begun, the limit is {BEGIN_WITHIN:g} s; send it again."
            return self._actions.rejected(request, "expired", text)
        return None

    async def _perform(self, request: StringCommand, job: Job) -> CommandOutcome:
        """Return the outcome of a job, however it ends: a client must not wait without end."""
        try:
            return await job()
        except RefusalError as refusal:
            return self._actions.refused(request, refusal)
        except PcmrsError as error:
            return self._actions.failed(request, error.code)
        except Exception:
            _log.exception("command_broke", command=request.spec.name)
            return self._actions.failed(request, "internal_error")

    async def _send_second(
        self, kind: Second, ended: asyncio.Future[CommandOutcome], send: Send, acknowledged: float
    ) -> None:
        """Send the second datagram, but never late: the client would take it for its next acknowledgement."""
        try:
            async with self._clock.timeout(SECOND_WITHIN):
                text = (await asyncio.shield(ended)).second(kind)
        except TimeoutError:
            text = NO_DATA
        # The loop may have stalled since: what counts is when the datagram is sent.
        late = self._clock.monotonic() - acknowledged
        if late < SECOND_BEFORE:
            send(text)
        else:
            _log.warning("second_datagram_not_sent", after=round(late, 3), limit=SECOND_BEFORE)


def _report(request: StringCommand, ended: asyncio.Future[CommandOutcome]) -> None:
    """Log a refusal, since clients without verdict replies do not receive it."""
    if not ended.cancelled() and (outcome := ended.result()).decision != "accepted":
        _log.warning(
            "command_refused",
            command=request.spec.name,
            decision=outcome.decision,
            branch=outcome.branch,
            state=outcome.state,
            reason=outcome.reason,
        )
