"""Intake of all links: limits connections, checks sender and grammar, and hands each command to its session."""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import partial

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.dispatcher import DispatcherListener
from pcmrs.dispatcher.verdict_cache import CommandCache
from pcmrs.errors import PayloadError, PcmrsError, RefusalError
from pcmrs.gateway.auth.admission import NOT_KEPT, Admission
from pcmrs.gateway.auth.peers import (
    BAD_TAG,
    CLOCK_AHEAD,
    NOT_ALLOWED,
    OLD_COUNTER,
    OVER_RATE,
    TOO_OLD,
    UNKNOWN_PEER,
    SignedPeer,
)
from pcmrs.gateway.commands import COMMANDS, Action
from pcmrs.gateway.grammar import StringCommand, parse, parse_tool_points
from pcmrs.gateway.handlers import CommandHandlers, PlanLock, Services
from pcmrs.gateway.peer_session import QUEUE_FULL, IdentifiedCommand, PeerSession, ReplyChannel
from pcmrs.gateway.signing import Signed, split
from pcmrs.messages import Command
from pcmrs.messages.identity import ON_SITE, Principal

MAX_SESSIONS = 256
STREAMS = ("tcp", "openigtlink")
"""Links over TCP."""
TOO_MANY = "too_many_connections"
LINK_ERROR = "link_error"
"""Reason if the content was not wrong, or only a part of it arrived."""
PLAN_POSE = COMMANDS["target_tslxxxxxx"]
"""Command that a signed peer must be allowed to give if it sends tool points."""
OF_PEERS = (UNKNOWN_PEER, BAD_TAG, OLD_COUNTER, TOO_OLD, CLOCK_AHEAD, NOT_ALLOWED, OVER_RATE, NOT_KEPT)
"""Reasons why signed commands are refused; the first three are not answered."""


@dataclass(slots=True)
class Counters:
    """Datagrams and TCP frames since the start.

    Attributes:
        received: All of them.
        refused: Those that broke the grammar, or whose sender may not send commands.
        overflowed: Commands that were refused because too many of their peer were waiting.
        of_peers: Signed commands that were refused, by reason; those that were not authentic are in `refused`, too.
    """

    received: int = 0
    refused: int = 0
    overflowed: int = 0
    of_peers: dict[str, int] = field(default_factory=lambda: dict.fromkeys(OF_PEERS, 0))

    def table(self) -> dict[str, int]:
        """Return the counters under the names that the daemon reports."""
        own = {"received": self.received, "refused": self.refused, "overflowed": self.overflowed}
        return {f"gateway.{name}": many for name, many in (own | self.of_peers).items()}


class Intake(DispatcherListener):
    """Entry point that checks what arrives on any link and hands it to the sender's session.

    Args:
        services: Services that all peers share.
        tasks: Owner of the sessions' tasks.
        unsigned_peers: Hosts whose unsigned commands are accepted.
        admission: Admission of signed commands; None if no peer has a key.

    Attributes:
        counters: Numbers of datagrams and refusals.
        refusals: Log of all refusals.
    """

    def __init__(
        self,
        services: Services,
        tasks: BackgroundTasks,
        unsigned_peers: tuple[str, ...],
        admission: Admission | None = None,
    ) -> None:
        self.counters = Counters()
        self.refusals = services.refusals
        self._services = services
        self._tasks = tasks
        self._unsigned_peers = unsigned_peers
        self._admission = admission
        self._sessions: dict[str, PeerSession] = {}
        self._locks: dict[str, PlanLock] = {}
        self._outcomes: CommandCache[IdentifiedCommand] = CommandCache()
        self._clock: Clock = services.clock

    def receive(
        self,
        link: str,
        peer: tuple[str, int],
        exposed: bool,
        data: bytes,
        answer: ReplyChannel,
        arrived: float | None = None,
    ) -> PayloadError | RefusalError | None:
        """Take one datagram or frame; a refused one is counted and reported, and changes nothing.

        Args:
            link: Name of the link.
            peer: Host and port of the sender.
            exposed: The link is bound to another address than loopback.
            data: The bytes.
            answer: Channel for answers.
            arrived: Time of arrival, s of the machine's clock; by default now.

        Returns:
            None if the sender is known and the grammar is right; `PayloadError` if the grammar is broken or the sender
            may not send unsigned commands; `RefusalError` if a signature is wrong.
        """
        arrived = self._clock.monotonic() if arrived is None else arrived
        self.counters.received += 1
        signed = split(data)
        try:
            if signed is not None:
                self._receive_signed(link, peer, signed, answer, arrived)
            else:
                self._check_unsigned(peer[0], exposed)
                self._receive_unsigned(link, peer, data, answer, arrived)
        except (PayloadError, RefusalError) as error:
            self.refuse(link, peer, error)
            return error
        return None

    def takes_unsigned(self, host: str, exposed: bool) -> bool:
        """Return whether unsigned commands are accepted.

        Args:
            host: Host of the sender.
            exposed: The link is bound to another address than loopback.
        """
        return not exposed and host in self._unsigned_peers

    def refuse(self, link: str, peer: tuple[str, int], error: Exception) -> None:
        """Count and report a datagram or frame that is refused.

        Args:
            link: Name of the link.
            peer: Host and port of the sender.
            error: Why it is refused.
        """
        self.counters.refused += 1
        reason = _reason_of(error)
        self._count(reason)
        self.refusals.add(source_of(link, peer), reason, str(error))

    def on_stop(self) -> None:
        """Reject the commands of all peers that were sent before this Stop and have not begun."""
        if self._admission is not None:
            self._admission.halt()
        for session in self._sessions.values():
            session.halt()

    def on_accepted(self, command: Command) -> None:
        """Let the session of a peer know that one of its operations has ended."""
        session = self._sessions.get(command.source)
        if session is not None:
            session.note_end(command)

    def lock(self, holder: str) -> PlanLock:
        """Return the plan lock that all unsigned clients of a host share on all links, or that of a signed peer."""
        return self._locks.setdefault(holder, PlanLock())

    def _check_unsigned(self, host: str, exposed: bool) -> None:
        """Refuse unsigned commands, except from listed loopback peers on loopback links."""
        if exposed:
            raise PayloadError("The link is not bound to loopback, so it refuses unsigned commands: sign them.")
        if host not in self._unsigned_peers:
            raise PayloadError(f"Unsigned commands from {host} are refused; list it in unsigned_peers.", host=host)

    def _receive_unsigned(
        self, link: str, peer: tuple[str, int], data: bytes, answer: ReplyChannel, arrived: float
    ) -> None:
        points_mm = parse_tool_points(data)
        if points_mm is not None:
            self._services.streams.relay_tool_points(points_mm)
            return
        request = _as_meant(link, parse(data))
        self._session(source_of(link, peer), peer[0], ON_SITE, for_surgeon=True).receive(request, answer, arrived)

    def _receive_signed(
        self, link: str, sender: tuple[str, int], signed: Signed, answer: ReplyChannel, arrived: float
    ) -> None:
        """Answer an authentic command, refused or not; raise for any other datagram, which gets no answer."""
        if self._admission is None:
            raise RefusalError(UNKNOWN_PEER, "No peer has a key; make one with: pcmrs peers new NAME.")
        peer = self._admission.identify(signed)
        points_mm = parse_tool_points(signed.command.removesuffix(b";"))
        if points_mm is not None:
            self._receive_signed_points(self._admission, link, sender, peer, signed.counter, points_mm)
            return
        request = _as_meant(link, parse(signed.command))
        enter = partial(self._enter, peer, request, peer.signs(answer, signed.counter), arrived)
        objection = peer.objection(request.spec, signed.counter)
        if objection is not None or request.spec.action is Action.STOP:
            self._admission.enter_at_once(peer, enter, objection)
        else:
            self._admission.enter_when_kept(peer, enter)

    def _receive_signed_points(
        self,
        admission: Admission,
        link: str,
        sender: tuple[str, int],
        peer: SignedPeer,
        counter: int,
        points_mm: tuple[float, ...],
    ) -> None:
        """Relay tool points of a peer that may plan a tool pose, which they propose; they are never answered."""

        def relay(refusal: RefusalError | None) -> None:
            if refusal is None:
                self._services.streams.relay_tool_points(points_mm)
            else:
                self.refuse(link, sender, refusal)

        objection = peer.objection(PLAN_POSE, counter)
        if objection is not None:
            admission.enter_at_once(peer, relay, objection)
        else:
            admission.enter_when_kept(peer, relay)

    def _enter(
        self,
        peer: SignedPeer,
        request: StringCommand,
        answer: ReplyChannel,
        arrived: float,
        refusal: RefusalError | None,
    ) -> None:
        """Begin a peer's command; its session, lock and ids are its own, whatever address it sends from."""
        if refusal is not None:
            self._count(refusal.refusal_code)
        session = self._session(peer.source, peer.source, peer.asker, for_surgeon=peer.for_surgeon)
        session.receive(request, answer, arrived, refusal)

    def _session(self, source: str, holder: str, asker: Principal, *, for_surgeon: bool) -> PeerSession:
        """Session of a source, moved to the end of the order in which idle ones are forgotten."""
        session = self._sessions.pop(source, None)
        if session is None:
            lock = self.lock(holder)
            session = self._new_session(CommandHandlers(source, asker, self._services, lock, for_surgeon=for_surgeon))
        self._sessions[source] = session
        return session

    def _new_session(self, actions: CommandHandlers) -> PeerSession:
        if len(self._sessions) >= MAX_SESSIONS:
            oldest_idle = next((key for key, session in self._sessions.items() if session.idle), None)
            if oldest_idle is not None:
                del self._sessions[oldest_idle]
        return PeerSession(actions, self._clock, self._tasks, self._outcomes, self._count_overflow)

    def _count(self, reason: str) -> None:
        if reason in self.counters.of_peers:
            self.counters.of_peers[reason] += 1
        elif reason == QUEUE_FULL:
            self._count_overflow()

    def _count_overflow(self) -> None:
        self.counters.overflowed += 1


def source_of(link: str, peer: tuple[str, int]) -> str:
    """Return the source of an unsigned sender, as it is journalled.

    Args:
        link: Name of the link.
        peer: Host and port of the sender.
    """
    host, port = peer
    return f"{link}:{host}:{port}" if link in STREAMS else f"udp:{link}:{host}:{port}"


def _reason_of(error: Exception) -> str:
    if isinstance(error, RefusalError):
        return error.refusal_code
    return error.code if isinstance(error, PcmrsError) else LINK_ERROR


def _as_meant(link: str, request: StringCommand) -> StringCommand:
    """On the MEP link, saving a placement means logging poses."""
    if link == "mep" and request.spec.action is Action.SAVE_PLACEMENT:
        return replace(request, spec=COMMANDS["save_continupose"])
    return request


class ConnectionLimit:
    """Places for the connections of one link.

    A place is taken when a connection is accepted, before any task serves it: so a burst of connections finds no more
    places than there are.

    Args:
        link: Name of the link, for refusals.
        intake: Counts and reports refusals.
        most: Number of places. Each needs a descriptor, of which there must be some left.
        most_of_a_host: Number of places for one address.
    """

    def __init__(self, link: str, intake: Intake, most: int, most_of_a_host: int) -> None:
        self._link = link
        self._intake = intake
        self._most = most
        self._most_of_a_host = most_of_a_host
        self._open: Counter[str] = Counter()

    def take(self, writer: asyncio.StreamWriter) -> tuple[str, int] | None:
        """Take a place for a new connection.

        Returns:
            Host and port of the peer; None if the connection was ended instead.
        """
        peer = peer_of(writer)
        if peer is None:
            writer.transport.abort()
            return None
        host = peer[0]
        for count, limit, whose in (
            (self._open[host], self._most_of_a_host, f"from {host}"),
            (self._open.total(), self._most, "in all"),
        ):
            if count >= limit:
                text = f"{count} connections are open {whose}, limit {limit}; close one that you do not need."
                self._intake.refuse(self._link, peer, RefusalError(TOO_MANY, text, count=count, limit=limit))
                writer.transport.abort()
                return None
        self._open[host] += 1
        return peer

    def free(self, peer: tuple[str, int]) -> None:
        """Free the place of a connection that has ended."""
        self._open[peer[0]] -= 1


def peer_of(writer: asyncio.StreamWriter) -> tuple[str, int] | None:
    """Return host and port of the peer; None if it has closed the connection already."""
    name = writer.get_extra_info("peername")
    return None if name is None else (name[0], name[1])
