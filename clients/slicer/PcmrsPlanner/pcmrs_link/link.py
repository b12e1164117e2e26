"""Sockets that never wait: a timer calls `Link.tick`, which takes all that has come and repeats the unanswered."""

from __future__ import annotations

import secrets
import socket
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field

from .messages import MessageError, Reading, Verdict, command, parse_stream, parse_verdict
from .poses import Pose, PoseError
from .signer import Signer

PLANNER_PORT = 8057
POSE_PORT = 8079
POINT_PORT = 8083

REPEAT_AFTER = 0.25
"""Seconds without an answer after which a command is sent again; it doubles each time."""
REPEAT_AT_MOST = 1.0
STOP_REPEAT = 0.25
STOP_WITHIN = 10.0
"""Seconds that Stop is repeated for."""
SETTLE_WITHIN = 3.0
"""Time after Stop in which the interrupted command is answered, s; after that, its outcome is unknown."""
MAX_DATAGRAMS = 10_000
"""Taken from one socket in one tick, so that a flood does not freeze the program."""
BUFFER = 1 << 20
"""Bytes of a stream that the system is asked to keep while the program does something else."""

NO_ANSWER = "no_answer"
NOBODY = "nobody_listens"
STOP = "stop_now_xxxxxxx"

Values = tuple[float, ...]
Then = Callable[[Verdict], None]


class LinkError(OSError):
    """The link cannot be opened."""


class BusyError(RuntimeError):
    """A job is running; only Stop can run beside it."""


@dataclass(frozen=True)
class Step:
    """One command of a job: it has to end within so many seconds."""

    name: str
    values: Values = ()
    timeout: float = 10.0


@dataclass
class Seen:
    """The newest of a stream, and when it was taken from its socket, by the link's clock."""

    value: Pose | tuple[float, ...]
    at: float


@dataclass
class Counts:
    """What has come and gone."""

    sent: int = 0
    repeated: int = 0
    received: int = 0
    dropped: int = 0


@dataclass
class _Waiting:
    """A command that is sent until it is answered, or until `until`."""

    number: int
    datagram: bytes
    until: float
    interval: float
    next_at: float
    repeats: bool = True


@dataclass
class _Job:
    title: str
    steps: deque[Step]
    then: Then
    began: float
    waiting: _Waiting | None = None


@dataclass
class Link:
    """The client's end of the string protocol: one job at a time, and Stop at any time.

    A job is a series of commands; each is sent when the one before was accepted, and the first that is not ends it.
    Each has a number and is repeated until it is answered, which runs nothing twice; Stop ends the repeating.

    Args:
        host: The daemon's, IPv4.
        port: Of its planner link.
        pose_port: Where the tool's poses come; None does not listen.
        point_port: Where pointer tip and tool points come; None does not listen.
        signer: Signs the commands and checks the answers; None sends them unsigned, which is taken on the daemon's own
            machine only.
        clock: Seconds that only grow.

    Attributes:
        seen: Newest of each stream by kind, see `Reading`.
        counts: What has come and gone.

    Raises:
        LinkError: The host is not known, or a port is in use.
    """

    host: str = "127.0.0.1"
    port: int = PLANNER_PORT
    pose_port: int | None = POSE_PORT
    point_port: int | None = POINT_PORT
    signer: Signer | None = None
    clock: Callable[[], float] = time.monotonic
    seen: dict[str, Seen] = field(default_factory=dict, init=False)
    counts: Counts = field(default_factory=Counts, init=False)

    def __post_init__(self) -> None:
        self._job: _Job | None = None
        self._stop: _Job | None = None
        self._closed_at = -1.0
        # A socket may get the port of an earlier one, whose numbers the daemon remembers.
        self._last_number = secrets.randbelow(9 * 10**9)
        self._commands, self._streams = self._open()
        self._peer: str = self._commands.getpeername()[0]

    def close(self) -> None:
        """Close the sockets without a report to waiting jobs."""
        self._job = self._stop = None
        for each in (self._commands, *self._streams):
            each.close()

    @property
    def under_way(self) -> str | None:
        """Title of the job that is not answered yet."""
        return None if self._job is None else self._job.title

    @property
    def waited(self) -> float:
        """Time since the running job began, s; 0 without one."""
        return 0.0 if self._job is None else self.clock() - self._job.began

    @property
    def stopping(self) -> bool:
        """True if a Stop is not answered yet."""
        return self._stop is not None

    def age(self, kind: str) -> float | None:
        """Seconds since the newest of a stream was taken; None if none has arrived."""
        seen = self.seen.get(kind)
        return None if seen is None else self.clock() - seen.at

    def begin(self, title: str, *steps: Step, then: Then) -> None:
        """Start a job; a tick calls `then` with the verdict that ended it.

        Raises:
            BusyError: Another is running.
            MessageError: A value cannot be sent; nothing was.
        """
        if self._job is not None:
            raise BusyError(f"{title}: {self._job.title} is running.")
        for step in steps:
            command(step.name, *step.values, number=self._last_number)
        self._job = _Job(title, deque(steps), then, self.clock())
        self._advance(self._job)

    def stop(self, then: Then) -> None:
        """Send Stop at once. The running job sends no further command, and repeats none.

        It is repeated until it is answered; `then` is called with that, unless another Stop comes before.
        """
        if self._job is not None:
            self._job.steps.clear()
            if self._job.waiting is not None:
                self._job.waiting.repeats = False
                self._job.waiting.until = min(self._job.waiting.until, self.clock() + SETTLE_WITHIN)
        self._stop = _Job("Stop", deque([Step(STOP, timeout=STOP_WITHIN)]), then, self.clock())
        self._advance(self._stop)

    def tick(self) -> None:
        """Take everything that has arrived, repeat unanswered commands, and give up late ones; never wait."""
        for data, _ in self._drain(self._commands):
            self._take_verdict(data)
        for stream in self._streams:
            for data, sender in self._drain(stream):
                self._take_reading(data, sender)
        now = self.clock()
        for job in (self._stop, self._job):
            if job is not None and job.waiting is not None:
                self._wait(job, job.waiting, now)

    def _open(self) -> tuple[socket.socket, list[socket.socket]]:
        opened: list[socket.socket] = []
        try:
            commands = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            opened.append(commands)
            commands.setblocking(False)
            commands.connect((self.host, self.port))
            local = commands.getsockname()[0]
            for port in (self.pose_port, self.point_port):
                if port is not None:
                    stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                    opened.append(stream)
                    stream.setblocking(False)
                    stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
                    _bind(stream, local, port)
        except OSError as error:
            for each in opened:
                each.close()
            raise LinkError(f"No link with {self.host}: {error}") from error
        return commands, opened[1:]

    def _drain(self, source: socket.socket) -> Iterator[tuple[bytes, str]]:
        for _ in range(MAX_DATAGRAMS):
            try:
                data, sender = source.recvfrom(2048)
            except ConnectionError:  # an earlier datagram came back; the repeating goes on
                self._closed_at = self.clock()
                continue
            except OSError:
                return
            self.counts.received += 1
            yield data, sender[0]

    def _take_verdict(self, data: bytes) -> None:
        try:
            number, verdict = parse_verdict(data if self.signer is None else self.signer.check(data))
        except ValueError:  # no verdict, or not the daemon's
            self.counts.dropped += 1
            return
        for job in (self._stop, self._job):
            if job is not None and job.waiting is not None and job.waiting.number == number:
                job.waiting = None
                if verdict.accepted and job.steps:
                    self._advance(job)
                else:
                    self._end(job, verdict)

    def _take_reading(self, data: bytes, sender: str) -> None:
        reading = _reading(data) if sender == self._peer else None
        if reading is None:
            self.counts.dropped += 1
        else:
            self.seen[reading.kind] = Seen(reading.value, self.clock())

    def _advance(self, job: _Job) -> None:
        """Send the next command of a job."""
        step = job.steps.popleft()
        self._last_number += 1
        datagram = command(step.name, *step.values, number=self._last_number)
        interval = STOP_REPEAT if job is self._stop else REPEAT_AFTER
        now = self.clock()
        job.waiting = _Waiting(self._last_number, datagram, now + step.timeout, interval, now + interval)
        self._send(datagram)

    def _wait(self, job: _Job, waiting: _Waiting, now: float) -> None:
        if now >= waiting.until:
            self._end(job, Verdict("unknown", "", "", NOBODY if self._closed_at >= job.began else NO_ANSWER))
        elif waiting.repeats and now >= waiting.next_at:
            if job is not self._stop:
                waiting.interval = min(2.0 * waiting.interval, REPEAT_AT_MOST)
            waiting.next_at = now + waiting.interval
            self.counts.repeated += 1
            self._send(waiting.datagram)

    def _end(self, job: _Job, verdict: Verdict) -> None:
        """The slot is free before `then` is called, so that this may begin the next job."""
        if job is self._stop:
            self._stop = None
        else:
            self._job = None
        job.then(verdict)

    def _send(self, datagram: bytes) -> None:
        self.counts.sent += 1
        # Signed again each time: the daemon accepts each counter once. What cannot be sent is repeated.
        with suppress(OSError):
            self._commands.send(datagram if self.signer is None else self.signer.sign(datagram))


def _reading(data: bytes) -> Reading | None:
    try:
        return parse_stream(data)
    except (MessageError, PoseError):
        return None


def _bind(stream: socket.socket, host: str, port: int) -> None:
    try:
        stream.bind((host, port))
    except OSError as error:
        text = f"UDP port {port} of {host} cannot be bound ({error.strerror}); another program may listen there."
        raise LinkError(text) from error
