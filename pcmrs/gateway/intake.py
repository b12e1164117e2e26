"""The gate of all links: who may send, what parses, and which session it belongs to."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

from pcmrs.clock import Clock
from pcmrs.errors import PayloadError, PcmrsError
from pcmrs.gateway.actions import Actions, Services
from pcmrs.gateway.commands import COMMANDS, Action
from pcmrs.gateway.grammar import Request, parse, parse_tool_points
from pcmrs.gateway.memory import Memory
from pcmrs.gateway.series import PlanLock
from pcmrs.gateway.session import Answer, Session
from pcmrs.gateway.tasks import Tasks

MAX_SESSIONS = 256
STREAMS = ("tcp", "openigtlink")
"""Links that are no UDP."""
LINK_ERROR = "link_error"
"""Reason where nothing was wrong with what was sent, or only a part of it came."""


@dataclass(slots=True)
class Counters:
    """Datagrams and TCP frames since the start.

    Attributes:
        received: All of them.
        refused: Those that did not parse or came from where commands are not accepted.
        overflowed: Commands refused because too many of their peer were waiting.
    """

    received: int = 0
    refused: int = 0
    overflowed: int = 0

    def table(self) -> dict[str, int]:
        """The same under the names that the daemon's counters have."""
        return {f"gateway.{name}": many for name, many in asdict(self).items()}


class Intake:
    """Checks what arrives on any link and hands it to the sender's session.

    Args:
        services: What all peers share.
        tasks: Owns what the sessions run.
        unsigned_peers: Hosts whose unsigned commands are accepted.

    Attributes:
        counters: What arrived and was refused.
        refusals: Told of everything that is refused.
    """

    def __init__(self, services: Services, tasks: Tasks, unsigned_peers: tuple[str, ...]) -> None:
        self.counters = Counters()
        self.refusals = services.refusals
        self._services = services
        self._tasks = tasks
        self._unsigned_peers = unsigned_peers
        self._sessions: dict[tuple[str, str, int], Session] = {}
        self._locks: dict[str, PlanLock] = {}
        self._memory = Memory()
        self._clock: Clock = services.clock

    def receive(self, link: str, peer: tuple[str, int], exposed: bool, data: bytes, answer: Answer) -> None:
        """Takes one datagram or frame; what is refused is counted, told and changes nothing.

        Args:
            link: Name of the link it came by.
            peer: Host and port of the sender.
            exposed: Whether the link is bound to another address than loopback.
            data: The bytes.
            answer: Where answers go.
        """
        self.counters.received += 1
        try:
            self._check_sender(peer[0], exposed)
            points_mm = parse_tool_points(data)
            request = None if points_mm is not None else parse(data)
        except PayloadError as error:
            self.refuse(link, peer, error)
            return
        if request is None:
            self._services.streams.relay_tool_points(points_mm or ())
        else:
            self._session(link, peer).receive(_as_meant(link, request), answer)

    def refuse(self, link: str, peer: tuple[str, int], error: Exception) -> None:
        """Counts what cannot be taken, and has it told."""
        self.counters.refused += 1
        reason = error.code if isinstance(error, PcmrsError) else LINK_ERROR
        self.refusals.add(source_of(link, peer), reason, str(error))

    def halt(self) -> None:
        """Lets nothing that any peer sent before now begin, as Stop demands."""
        for session in self._sessions.values():
            session.halt()

    def lock(self, host: str) -> PlanLock:
        """The plan lock that all clients of a host share, whatever link they come by."""
        return self._locks.setdefault(host, PlanLock())

    def _check_sender(self, host: str, exposed: bool) -> None:
        """Unsigned commands, and all are unsigned here, come from listed loopback peers on loopback links only."""
        if exposed:
            raise PayloadError("The link is not bound to loopback, so it refuses unsigned commands; bind 127.0.0.1.")
        if host not in self._unsigned_peers:
            raise PayloadError(f"Unsigned commands from {host} are refused; list it in unsigned_peers.", host=host)

    def _session(self, link: str, peer: tuple[str, int]) -> Session:
        """The peer's session, moved to the end of the order in which idle ones are forgotten."""
        key = (link, *peer)
        session = self._sessions.pop(key, None) or self._new_session(link, peer)
        self._sessions[key] = session
        return session

    def _new_session(self, link: str, peer: tuple[str, int]) -> Session:
        if len(self._sessions) >= MAX_SESSIONS:
            oldest_idle = next((key for key, session in self._sessions.items() if session.idle), None)
            if oldest_idle is not None:
                del self._sessions[oldest_idle]
        actions = Actions(source_of(link, peer), self._services, self.lock(peer[0]))
        return Session(actions, self._clock, self._tasks, self._memory, self._count_overflow)

    def _count_overflow(self) -> None:
        self.counters.overflowed += 1


def source_of(link: str, peer: tuple[str, int]) -> str:
    """Who sends over a link, as the daemon records it."""
    host, port = peer
    return f"{link}:{host}:{port}" if link in STREAMS else f"udp:{link}:{host}:{port}"


def _as_meant(link: str, request: Request) -> Request:
    """On the MEP link, saving a placement means logging poses."""
    if link == "mep" and request.spec.action is Action.SAVE_PLACEMENT:
        return replace(request, spec=COMMANDS["save_continupose"])
    return request
