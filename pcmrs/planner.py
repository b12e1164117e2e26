"""An external planner over UDP, as a lab's own script would be: it plans, registers and places, and imports no more.

Uses verdict replies: every command carries an id, and is repeated with the same id until it is answered. With a key it
signs them, so that it need not run on the daemon's machine.
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

REPEAT_AFTER = 0.5
"""Seconds without an answer after which a command is sent again; it doubles each time."""
REPEAT_AT_MOST = 1.0
"""It does not grow beyond this: with a fifth of the datagrams lost, one of 100,000 commands has no verdict in 10 s."""

Decision = Literal["accepted", "rejected", "failed"]


@dataclass(frozen=True, slots=True)
class PlannerVerdict:
    """The answer to one command; `results` are in the units of the wire."""

    decision: Decision
    branch: str
    state: str
    reason: str | None = None
    results: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class MeasuredPlacement:
    """What the tracker measured at the target: pose of the coil in the image (m, x y z w) and its errors."""

    position: tuple[float, ...]
    quat_xyzw: tuple[float, ...]
    translation_error_mm: float
    rotation_error_deg: float


class Planner(asyncio.DatagramProtocol):
    """A client of the planner link; open it with `Planner.open`, as a context or with `close`.

    Args:
        signer: Signs the commands and checks the answers; None sends them unsigned, which is accepted from loopback
            only.
    """

    def __init__(self, signer: Signer | None = None) -> None:
        self._signer = signer
        self._transport: asyncio.DatagramTransport
        self._answers: dict[str, asyncio.Future[PlannerVerdict]] = {}
        # A socket may get the port of an earlier one, whose ids the daemon remembers.
        self._last_id = secrets.randbelow(9 * 10**9)

    @classmethod
    async def open(cls, host: str = "127.0.0.1", port: int = 8057, signer: Signer | None = None) -> Self:
        """Opens a socket towards the daemon's planner link; with a signer, commands are signed."""
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
        """Closes the socket; what waits for an answer is cancelled."""
        for answer in self._answers.values():
            answer.cancel()
        self._transport.close()

    async def command(self, name: str, *tokens: Value, timeout: float = 10.0) -> PlannerVerdict:
        """Sends a command and returns its verdict.

        Args:
            name: The 16 characters.
            *tokens: Its payload.
            timeout: Seconds to wait for the verdict, that is for the end of the operation.

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
        """Plans landmarks at `points` in the image, m, (N, 3)."""
        await self._demand("img_fid_numxxxxx", len(points))
        for index, point in enumerate(points):
            await self._demand("img_fid_pntxxxxx", index, *map(float, point))
        await self._demand("img_fid_lastrecv")

    async def digitize_all(self) -> None:
        """Has all landmarks digitized in order."""
        await self._demand("start_autodigitz", timeout=600.0)

    async def digitize_one(self, index: int) -> None:
        """Has one landmark digitized; `index` counts from 0 in the order of the plan."""
        await self._demand("img_dig_digitize", index, timeout=90.0)

    async def register(self) -> float:
        """Registers; returns the mean residual in mm."""
        return (await self._demand("start_registrati")).results[0]

    async def plan_pose(self, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
        """Plans the pose of the tool in the image: m, and a unit quaternion x y z w."""
        await self._demand("target_rotxxxxxx", *map(float, quat_xyzw))
        await self._demand("target_tslxxxxxx", *map(float, position))

    async def connect(self) -> None:
        """Connects the robot."""
        await self._demand("rob_conn_onxxxxx", timeout=30.0)

    async def approach(self) -> None:
        """Moves to the standoff of the planned pose."""
        await self._demand("execute_motionxx", timeout=120.0)

    async def confirm(self) -> MeasuredPlacement:
        """Advances to the planned pose; returns what the tracker measured there."""
        results = (await self._demand("execute_confirmx", timeout=120.0)).results
        return MeasuredPlacement(results[:3], results[3:7], results[7], results[8])

    async def back_off(self) -> None:
        """Withdraws along the tool axis."""
        await self._demand("execute_bkoffset", timeout=120.0)

    async def home(self) -> None:
        """Moves to the home posture."""
        await self._demand("execute_homexxxx", timeout=240.0)

    async def reinitiate(self) -> None:
        """Starts the procedure anew: no landmarks, no registration, no planned pose."""
        await self._demand("session_reinitxx")

    async def stop(self) -> None:
        """Stops everything at once."""
        await self._demand("stop_now_xxxxxxx")

    async def _demand(self, name: str, *tokens: Value, timeout: float = 10.0) -> PlannerVerdict:
        """Raises `CommandRefusedError` unless the command is accepted."""
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
            # Signed anew each time: a datagram that was sent once is refused as a replay.
            self._transport.sendto(datagram if self._signer is None else self._signer.sign(datagram))
            done, _ = await asyncio.wait([answer], timeout=interval)
            if done:
                return answer.result()
            interval = min(2.0 * interval, REPEAT_AT_MOST)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by the event loop once the socket is open."""
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, _: tuple[Any, ...]) -> None:
        """Called by the event loop for every answer; what is no verdict, or not the daemon's, is dropped."""
        try:
            client_id, verdict = parse_reply(data if self._signer is None else self._signer.check(data))
        except PayloadError:
            return
        answer = self._answers.get(client_id)
        if answer is not None and not answer.done():
            answer.set_result(verdict)

    def error_received(self, _: Exception) -> None:
        """Called by the event loop when the daemon's port is closed; the repetition goes on."""


def parse_reply(data: bytes) -> tuple[str, PlannerVerdict]:
    """The command's id and its verdict.

    Raises:
        PayloadError: The datagram is no verdict reply.
    """
    try:
        text = data.decode("ascii").removesuffix(";")
        client_id, decision, branch, state, *rest = text.split("_", 4)
        results = tuple(map(float, rest[0].split("_"))) if decision == "accepted" and rest else ()
    except ValueError:
        raise PayloadError(f"{data[:60]!r} is no verdict reply.") from None
    if decision not in ("accepted", "rejected", "failed"):
        raise PayloadError(f"{decision!r} is no decision; accepted, rejected or failed are.", decision=decision)
    reason = rest[0] if decision != "accepted" and rest else None
    return client_id, PlannerVerdict(cast(Decision, decision), branch, state, reason, results)
