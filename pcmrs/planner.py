"""Client of the planner link (UDP) for scripts of a lab: it plans, registers and places.

Every command carries an id and is repeated with the same id until its verdict arrives. With a key, commands are signed,
so that the script may run on another machine than the daemon.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal, Self, cast

from pcmrs.errors import CommandRefusedError, PayloadError, UnknownOutcomeError
from pcmrs.gateway.commands import Value
from pcmrs.gateway.grammar import format_command
from pcmrs.gateway.signing import Signer

__all__ = ["Decision", "MeasuredPlacement", "Planner", "PlannerVerdict", "Signer"]

REPEAT_AFTER = 0.5
"""Time without an answer after which a command is first repeated, s; it doubles each time."""
REPEAT_AT_MOST = 1.0
"""Longest time between two repetitions, s.

With 20 % of the datagrams lost, 1 of 100,000 commands gets no verdict within 10 s.
"""

Decision = Literal["accepted", "rejected", "failed"]
"""Decision on a command, as the link reports it."""


@dataclass(frozen=True, slots=True)
class PlannerVerdict:
    """Verdict on one command.

    Attributes:
        decision: Decision on the command.
        branch: Branch of its operation.
        state: State of the branch after the decision.
        reason: Code of the reason if the command was not accepted.
        results: Results of the operation in the units of the wire.
    """

    decision: Decision
    branch: str
    state: str
    reason: str | None = None
    results: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class MeasuredPlacement:
    """Measured placement at the target.

    Attributes:
        position: Position of the coil in the image, m, (3,).
        quat_xyzw: Orientation of the coil in the image, unit quaternion x y z w.
        translation_error_mm: Distance from the planned position, mm.
        rotation_error_deg: Angle from the planned orientation, degrees.
    """

    position: tuple[float, ...]
    quat_xyzw: tuple[float, ...]
    translation_error_mm: float
    rotation_error_deg: float


class Planner(asyncio.DatagramProtocol):
    """A client of the planner link; open it with `Planner.open`, as a context or with `close`.

    Args:
        signer: Signer of commands, which also checks the answers. None sends unsigned commands, which the daemon
            accepts from loopback only.
    """

    def __init__(self, signer: Signer | None = None) -> None:
        self._signer = signer
        self._transport: asyncio.DatagramTransport
        self._answers: dict[str, asyncio.Future[PlannerVerdict]] = {}
        # Random, because the daemon remembers the ids of an earlier socket with the same port.
        self._last_id = secrets.randbelow(9 * 10**9)

    @classmethod
    async def open(cls, host: str = "127.0.0.1", port: int = 8057, signer: Signer | None = None) -> Self:
        """Open a socket to the daemon's planner link.

        Args:
            host: Host name or address of the daemon.
            port: UDP port of the planner link.
            signer: Signer of commands; None to send them unsigned.
        """
        loop = asyncio.get_running_loop()
        _, planner = await loop.create_datagram_endpoint(lambda: cls(signer), remote_addr=(host, port))
        return planner

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the socket, and cancel the calls that wait for an answer."""
        for answer in self._answers.values():
            answer.cancel()
        self._transport.close()

    async def command(self, name: str, *tokens: Value, timeout: float = 10.0) -> PlannerVerdict:
        """Send a command and return its verdict.

        Args:
            name: Name of the command, 16 characters.
            *tokens: Payload of the command.
            timeout: Longest wait for the verdict, that is for the end of the operation, s.

        Raises:
            PayloadError: The payload does not fit the command.
            UnknownOutcomeError: No verdict came within `timeout`.
        """
        self._last_id += 1
        client_id = str(self._last_id)
        datagram = format_command(name, *tokens, client_id=client_id)
        answer = self._answers[client_id] = asyncio.get_running_loop().create_future()
        try:
            async with asyncio.timeout(timeout):
                return await self._repeat_until(answer, datagram)
        except TimeoutError:
            raise UnknownOutcomeError(
                f"No verdict on {name} within {timeout:g} s; look at the daemon's state before you go on.",
                command=name,
                timeout=timeout,
            ) from None
        finally:
            del self._answers[client_id]

    async def plan_landmarks(self, points: Sequence[Sequence[float]]) -> None:
        """Plan landmarks at `points` in the image, m, (N, 3)."""
        await self._demand("img_fid_numxxxxx", len(points))
        for index, point in enumerate(points):
            await self._demand("img_fid_pntxxxxx", index, *map(float, point))
        await self._demand("img_fid_lastrecv")

    async def digitize_all(self) -> None:
        """Digitize all landmarks in order."""
        await self._demand("start_autodigitz", timeout=600.0)

    async def digitize_one(self, index: int) -> None:
        """Digitize one landmark; `index` counts from 0 in the order of the plan."""
        await self._demand("img_dig_digitize", index, timeout=90.0)

    async def register(self) -> float:
        """Register, and return the mean residual, mm."""
        return (await self._demand("start_registrati")).results[0]

    async def plan_pose(self, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
        """Plan the pose of the tool in the image.

        Args:
            position: Position, m, (3,).
            quat_xyzw: Orientation, unit quaternion x y z w.
        """
        await self._demand("target_rotxxxxxx", *map(float, quat_xyzw))
        await self._demand("target_tslxxxxxx", *map(float, position))

    async def connect(self) -> None:
        """Connect the robot."""
        await self._demand("rob_conn_onxxxxx", timeout=30.0)

    async def approach(self) -> None:
        """Move to the standoff of the planned pose."""
        await self._demand("execute_motionxx", timeout=120.0)

    async def confirm(self) -> MeasuredPlacement:
        """Advance to the planned pose, and return the placement that the tracker measured there."""
        results = (await self._demand("execute_confirmx", timeout=120.0)).results
        return MeasuredPlacement(results[:3], results[3:7], results[7], results[8])

    async def back_off(self) -> None:
        """Withdraw along the tool axis."""
        await self._demand("execute_bkoffset", timeout=120.0)

    async def home(self) -> None:
        """Move to the home posture."""
        await self._demand("execute_homexxxx", timeout=240.0)

    async def reinitiate(self) -> None:
        """Restart the procedure without landmarks, registration and planned pose."""
        await self._demand("session_reinitxx")

    async def stop(self) -> None:
        """Stop everything at once."""
        await self._demand("stop_now_xxxxxxx")

    async def _demand(self, name: str, *tokens: Value, timeout: float = 10.0) -> PlannerVerdict:
        """Send a command. Raises `CommandRefusedError` unless it is accepted."""
        verdict = await self.command(name, *tokens, timeout=timeout)
        if verdict.decision != "accepted":
            raise CommandRefusedError(
                f"{name} was {verdict.decision} in {verdict.branch} {verdict.state}: {verdict.reason}.",
                command=name,
                verdict=verdict,
            )
        return verdict

    async def _repeat_until(self, answer: asyncio.Future[PlannerVerdict], datagram: bytes) -> PlannerVerdict:
        interval = REPEAT_AFTER
        while True:
            # Signed again each time: a repeated datagram would be refused as a replay.
            self._transport.sendto(datagram if self._signer is None else self._signer.sign(datagram))
            done, _ = await asyncio.wait([answer], timeout=interval)
            if done:
                return answer.result()
            interval = min(2.0 * interval, REPEAT_AT_MOST)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the transport; the event loop calls this once the socket is open."""
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, _: tuple[Any, ...]) -> None:
        """Take an answer; one that is not a verdict, or not from the daemon, is dropped.

        Args:
            data: Datagram.
            _: Address of the sender, which is not used.
        """
        try:
            client_id, verdict = parse_reply(data if self._signer is None else self._signer.check(data))
        except PayloadError:
            return
        answer = self._answers.get(client_id)
        if answer is not None and not answer.done():
            answer.set_result(verdict)

    def error_received(self, _: Exception) -> None:
        """Ignore an error, as when the daemon's port is closed: the command is repeated."""


def parse_reply(data: bytes) -> tuple[str, PlannerVerdict]:
    """Parse a reply into the id of the command and its verdict.

    Raises:
        PayloadError: The datagram is not a verdict reply.
    """
    try:
        text = data.decode("ascii").removesuffix(";")
        client_id, decision, branch, state, *rest = text.split("_", 4)
        results = tuple(map(float, rest[0].split("_"))) if decision == "accepted" and rest else ()
    except ValueError:
        raise PayloadError(f"{data[:60]!r} is not a verdict reply.") from None
    if decision not in ("accepted", "rejected", "failed"):
        raise PayloadError(f"{decision!r} is not a decision: use accepted, rejected or failed.", decision=decision)
    reason = rest[0] if decision != "accepted" and rest else None
    return client_id, PlannerVerdict(cast(Decision, decision), branch, state, reason, results)
