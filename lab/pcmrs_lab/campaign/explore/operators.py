"""Operators of a simulated session: they see what is published, and send commands by bus and by wire."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from pcmrs.bus.stop import Press
from pcmrs.errors import PayloadError, PcmrsError
from pcmrs.gateway.commands import COMMANDS, Value
from pcmrs.gateway.grammar import format_command
from pcmrs.messages import Command, Snapshot, Verdict
from pcmrs.planner import PlannerVerdict, parse_reply
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs_lab.campaign.explore.watcher import Watcher
from pcmrs_sim.deterministic.cell import SimulatedCell
from pcmrs_sim.deterministic.daemon import SimulatedDaemon

PATIENCE = 60.0
"""Longest time that an operator waits for a verdict, s."""
REPEAT_AFTER = 0.5
"""Time after which a datagram without an answer is sent again, s; it doubles each time."""
TTL = 20.0
"""Age at which commands are too old, s."""

PORTS = {"anna": 40001, "ben": 40002}
"""Ports from which the operators send datagrams, by name."""
OLD_PORT = 40003
"""Port of a client that only knows acknowledgements."""


@dataclass
class Operators:
    """All operators share one endpoint, like two clients on one machine.

    Attributes:
        cell: Cell that they operate.
        acknowledged: Called with every verdict that reaches an operator.
        watcher: Watcher that learns what arrives at the daemon's links, and what is sent back late.
        clock: Clock of their machine.
        snapshot: Last snapshot that they received; None before the first and after the daemon was lost.
    """

    cell: SimulatedCell
    acknowledged: Callable[[Command, Verdict], None]
    watcher: Watcher
    clock: SimulatedClock = field(init=False)
    snapshot: Snapshot | None = None

    def __post_init__(self) -> None:
        self.clock = SimulatedClock(asyncio.get_running_loop())
        self._link = self.cell.network.endpoint("operator")
        self._link.subscribe("state/fsm", Snapshot, self._take_snapshot)
        self._number = 0
        self._ids: dict[str, str] = {}
        self._last: dict[str, Callable[[], Any]] = {}
        self._answers: dict[str, asyncio.Future[PlannerVerdict]] = {}

    async def operate(self, who: str, name: str, arguments: dict[str, Any]) -> None:
        """Request ``branch.operation`` on the bus.

        Args:
            who: Name of the operator.
            name: Operation, ``branch.operation``.
            arguments: Arguments of the operation.
        """
        self._number += 1
        await self._operate(who, name, arguments, f"{who}-{self._number}")

    async def _operate(self, who: str, name: str, arguments: dict[str, Any], command_id: str) -> None:
        branch, operation = name.split(".")
        command = Command(
            id=command_id,
            branch=branch,
            operation=operation,
            source=f"bus:{who}",
            arguments=arguments,
            sent=self.clock.wall(),
            ttl=TTL,
        )
        self._ids[who] = command_id
        self._last[who] = lambda: self._request(who, command)
        await self._request(who, command)

    async def reuse(self, who: str, name: str, arguments: dict[str, Any]) -> None:
        """Request another operation under the id of the last command of this operator on the bus, if there is one.

        Args:
            who: Name of the operator.
            name: Operation, ``branch.operation``.
            arguments: Arguments of the operation.
        """
        if who in self._ids:
            await self._operate(who, name, arguments, self._ids[who])
        else:
            await self.operate(who, name, arguments)

    def old_client(self, name: str, tokens: Sequence[Value]) -> None:
        """Send a string command without an id, like clients that only know acknowledgements.

        Args:
            name: Name of the command, 16 characters.
            tokens: Values of the command.
        """
        daemon = self.cell.daemon
        if daemon is None:
            return
        try:
            data = format_command(name, *tokens)
        except PayloadError:
            return
        loop = asyncio.get_running_loop()
        acknowledged: list[float] = []

        def answer(_text: str) -> None:
            if acknowledged:
                self.watcher.check_second_datagram(loop.time() - acknowledged[0])
            acknowledged.append(loop.time())

        self._link.send(daemon.link, self._arrive_old, name, daemon, data, answer)

    def _arrive_old(self, name: str, daemon: SimulatedDaemon, data: bytes, answer: Callable[[str], None]) -> None:
        spec = COMMANDS.get(name)
        for step in () if spec is None else spec.steps:
            self.watcher.arrived(f"{step.branch}.{step.operation}", asyncio.get_running_loop().time())
        daemon.receive(OLD_PORT, data, _ignore_verdict, answer)

    async def wire(self, who: str, name: str, tokens: Sequence[Value]) -> None:
        """Send a string command, and repeat it until it is answered.

        Args:
            who: Name of the operator.
            name: Name of the command, 16 characters.
            tokens: Values of the command.
        """
        self._number += 1
        client_id = str(self._number)
        try:
            datagram = format_command(name, *tokens, client_id=client_id)
        except PayloadError:
            return  # the client's own library refuses it
        self._last[who] = lambda: self._send_until_answered(who, client_id, datagram)
        await self._send_until_answered(who, client_id, datagram)

    async def repeat(self, who: str) -> None:
        """Send the last command of this operator once more, with the same id."""
        if who in self._last:
            await self._last[who]()

    def datagram(self, who: str, data: bytes) -> None:
        """Send a datagram that need not be a command.

        Args:
            who: Name of the operator.
            data: Bytes of the datagram.
        """
        self._send(who, data)

    def stop(self, who: str) -> None:
        """Press Stop: daemon and node receive it."""
        self._link.publish(f"stop/{who}", Press(id=uuid.uuid4().hex))

    async def _request(self, who: str, command: Command) -> None:
        key = f"cmd/{who}/{command.branch}/{command.operation}"
        try:
            verdict = await self._link.request(key, command, Verdict, PATIENCE)
        except PcmrsError:
            return  # the outcome is unknown: the operator checks the state
        self.acknowledged(command, verdict)

    async def _send_until_answered(self, who: str, client_id: str, datagram: bytes) -> None:
        answer = self._answers.setdefault(client_id, asyncio.get_running_loop().create_future())
        interval, waited = REPEAT_AFTER, 0.0
        while not answer.done() and waited < PATIENCE:
            self._send(who, datagram, client_id)
            await asyncio.wait([answer], timeout=interval)
            waited, interval = waited + interval, 2.0 * interval

    def _send(self, who: str, data: bytes, client_id: str = "") -> None:
        daemon = self.cell.daemon
        if daemon is None:
            return
        link = daemon.link

        def answer(text: str) -> None:
            link.send(self._link, self._answered, text)

        self._link.send(link, self._arrive, daemon, PORTS[who], data, client_id, answer)

    def _arrive(
        self, daemon: SimulatedDaemon, port: int, data: bytes, client_id: str, answer: Callable[[str], None]
    ) -> None:
        if client_id:
            self.watcher.command_arrived(client_id, asyncio.get_running_loop().time())
        daemon.receive(port, data, answer, None)

    def _answered(self, text: str) -> None:
        try:
            client_id, verdict = parse_reply(text.encode("ascii"))
        except PayloadError:
            return
        answer = self._answers.get(client_id)
        if answer is not None and not answer.done():
            answer.set_result(verdict)

    def _take_snapshot(self, _key: str, snapshot: Snapshot) -> None:
        self.snapshot = snapshot


def _ignore_verdict(_text: str) -> None:
    """Ignore a verdict: such a client only reads acknowledgements."""
