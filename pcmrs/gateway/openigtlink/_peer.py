"""One connection: commands from it, and a bounded queue of messages to it."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from pcmrs.clock import Clock
from pcmrs.devices.plus.messages import STATUS_EMERGENCY, STATUS_ERROR, STATUS_OK, StatusMessage, text_message
from pcmrs.errors import PayloadError
from pcmrs.gateway.commands import PlanKind
from pcmrs.gateway.openigtlink.plans import PlanOutcome, PlanSubmitter, landmarks, target
from pcmrs.gateway.settings import OpenIgtLinkConfig

KINDS = ("TRANSFORM", "POINT", "STRING")
STOP = "stop"
MAX_WAITING = 100
"""Limit of waiting messages other than poses; beyond it the oldest is dropped."""
STALLED_AFTER = 10.0
"""Limit after which a peer that reads nothing is disconnected, s."""

Plans = Callable[[Callable[[PlanOutcome], None]], PlanSubmitter]


class Peer:
    """Peer whose messages become commands, each once, and their outcomes into verdicts and a status.

    Args:
        config: Names of the messages that are plans.
        planner: Makes the planner from a function that receives the answers.
        wall: Returns Unix seconds, for the time stamps.
        trusted: Commands from this host are accepted.

    Attributes:
        outbox: Queue of messages to it.
        shown: The state that was sent last, by name; None before the first.
    """

    def __init__(self, config: OpenIgtLinkConfig, planner: Plans, wall: Callable[[], float], *, trusted: bool) -> None:
        self.outbox = Outbox()
        self.shown: dict[str, str] | None = None
        self._config = config
        self._planner = planner(self._take_answer)
        self._wall = wall
        self._trusted = trusted
        self._last: dict[PlanKind, object] = {}
        self._wrong: PlanOutcome | None = None
        self._latched = False

    def receive(self, message: Any) -> None:
        """Take one message; one that is neither a plan nor Stop changes nothing and is not answered.

        Raises:
            PayloadError: The message is a command, and commands from this host are not accepted.
        """
        name, kind = message.device_name, message.message_type
        if kind == "STRING" and message.string.strip().lower() == STOP:
            self._check_trusted()
            self._planner.stop()
        elif kind == "TRANSFORM" and name == self._config.target:
            matrix = message.matrix.tolist()
            self._plan(PlanKind.POSE, repr(matrix), partial(target, matrix))
        elif kind == "POINT" and name == self._config.landmarks:
            points = message.positions, message.names
            self._plan(PlanKind.LANDMARKS, repr(points), partial(landmarks, *points))

    def halt(self) -> None:
        """Reject the commands that wait, because of Stop."""
        self._planner.halt()

    def send_status(self, latched: bool) -> None:
        """Send the status: latched, or the reason of this peer's last rejection, or OK."""
        self._latched, wrong = latched, self._wrong
        if latched:
            text = "Stopped and latched: acknowledge it."
            status = StatusMessage(STATUS_EMERGENCY, "latched", text, **self._header("PcmrsStatus"))
        elif wrong is not None:
            status = StatusMessage(STATUS_ERROR, wrong.code, wrong.text, **self._header("PcmrsStatus"))
        else:
            status = StatusMessage(STATUS_OK, **self._header("PcmrsStatus"))
        self.outbox.put_pose("PcmrsStatus", status.pack())

    def _plan(self, kind: PlanKind, content: str, arguments: Callable[[], dict[str, Any]]) -> None:
        """Submit a plan if it has changed: Slicer resends a node whenever it is touched."""
        self._check_trusted()
        if self._last.get(kind) == content:
            return
        self._last[kind] = content
        self._planner.plan(kind, arguments)

    def _check_trusted(self) -> None:
        if not self._trusted:
            raise PayloadError("Commands over OpenIGTLink are not signed: they are taken from loopback peers only.")

    def _take_answer(self, answer: PlanOutcome) -> None:
        self._wrong = None if answer.decision == "accepted" else answer
        self.outbox.put(text_message(answer.line, **self._header("PcmrsVerdict")).pack())
        self.send_status(self._latched)

    def _header(self, name: str) -> dict[str, Any]:
        return {"device_name": name, "timestamp": self._wall()}


class Outbox:
    """Queue of the newest message of each pose, and of the newest `MAX_WAITING` other messages, in order.

    Attributes:
        dropped: Number of messages that newer ones have replaced.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._poses: dict[str, bytes] = {}
        self._rest: deque[bytes] = deque()
        self._filled = asyncio.Event()

    def put_pose(self, name: str, data: bytes) -> None:
        """Add a pose, in place of one of the same name that still waits.

        Args:
            name: Name of the pose.
            data: The packed message.
        """
        self.dropped += name in self._poses
        self._poses[name] = data
        self._filled.set()

    def put(self, data: bytes) -> None:
        """Add a message that later ones do not replace."""
        if len(self._rest) == MAX_WAITING:
            self._rest.popleft()
            self.dropped += 1
        self._rest.append(data)
        self._filled.set()

    async def send(self, writer: asyncio.StreamWriter, clock: Clock) -> None:
        """Send until cancelled, no faster than the peer reads.

        Args:
            writer: Connection to the peer.
            clock: The machine's clock.

        Raises:
            TimeoutError: The peer has read nothing for `STALLED_AFTER`.
            ConnectionError: The peer is gone.
        """
        # No message waits in the transport, where it could be neither counted nor replaced.
        writer.transport.set_write_buffer_limits(high=0)
        while True:
            await self._filled.wait()
            writer.write(self._take())
            async with clock.timeout(STALLED_AFTER):
                await writer.drain()

    def _take(self) -> bytes:
        data = b"".join([*self._rest, *self._poses.values()])
        self._rest.clear()
        self._poses.clear()
        self._filled.clear()
        return data
