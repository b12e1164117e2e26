"""Operators of a simulated session: they see what is published, and send commands by bus and by wire."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from pcmrs.errors import PayloadError, PcmrsError
from pcmrs.gateway.commands import COMMANDS, Value
from pcmrs.gateway.grammar import format_command
from pcmrs.messages import Beat, Command, Snapshot, Verdict
from pcmrs.planner import PlannerVerdict, parse_reply
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs_lab.campaign.explore.watcher import Watcher
from pcmrs_sim.deterministic.cell import SimulatedCell
from pcmrs_sim.deterministic.daemon import SimulatedDaemon

PATIENCE = 60.0
"""Nobody waits longer for a verdict, s."""
REPEAT_AFTER = 0.5
"""Without an answer a datagram is sent again after this; it doubles each time, s."""
TTL = 20.0
"""Commands are too old after this, s."""

PORTS = {"anna": 40001, "ben": 40002}
"""The operators and the ports they send datagrams from."""
OLD_PORT = 40003
"""Of a client that only knows acknowledgements."""


@dataclass
class Operators:
    """All operators share one endpoint, as two clients on one machine do.

    Attributes:
        cell: They work with.
        acknowledged: Told of every verdict that reached an operator.
        watcher: Told what arrives at the daemon's links, and what is sent back late.
        clock: Of their machine.
        snapshot: As they were shown last; None before the first and after the daemon was lost.
    """

    cell: SimulatedCell
    acknowledged: Callable[[Command, Verdict], None]
    watcher: Watcher
    clock: SimulatedClock = field(init=False)
    snapshot: Snapshot | None = None

    def __post_init__(self) -> None:
        self.clock = SimulatedClock(asyncio.get_running_loop())
        self._link = self.cell.network.endpoint("operator")
        self._link.subscribe("state/fsm", Snapshot, self._see)
        self._number = 0
        self._last: dict[str, Callable[[], Any]] = {}
        self._answers: dict[str, asyncio.Future[PlannerVerdict]] = {}

    async def operate(self, who: str, name: str, arguments: dict[str, Any]) -> None:
        """Asks for ``branch.operation`` on the bus."""
        branch, operation = name.split(".")
        self._number += 1
        command = Command(
            id=f"{who}-{self._number}",
            branch=branch,
            operation=operation,
            source=f"bus:{who}",
            arguments=arguments,
            sent=self.clock.wall(),
            ttl=TTL,
        )
        self._last[who] = lambda: self._ask(who, command)
        await self._ask(who, command)

    async def reuse(self, who: str, name: str, arguments: dict[str, Any]) -> None:
        """Asks for another operation under the id of the last command of this operator on the bus."""
        self._number -= bool(self._number)
        await self.operate(who, name, arguments)

    def old_client(self, name: str, tokens: Sequence[Value]) -> None:
        """Sends a string command without an id, as clients do that only know acknowledgements."""
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
                self.watcher.second(loop.time() - acknowledged[0])
            acknowledged.append(loop.time())

        self._link.send(daemon.link, self._arrive_old, name, daemon, data, answer)

    def _arrive_old(self, name: str, daemon: SimulatedDaemon, data: bytes, answer: Callable[[str], None]) -> None:
        spec = COMMANDS.get(name)
        for step in () if spec is None else spec.steps:
            self.watcher.arrived(f"{step.branch}.{step.operation}", asyncio.get_running_loop().time())
        daemon.receive(OLD_PORT, data, _nowhere, answer)

    async def wire(self, who: str, name: str, tokens: Sequence[Value]) -> None:
        """Sends a string command, again and again until it is answered."""
        self._number += 1
        client_id = str(self._number)
        try:
            datagram = format_command(name, *tokens, client_id=client_id)
        except PayloadError:
            return  # the client's own library refuses it
        self._last[who] = lambda: self._demand(who, client_id, datagram)
        await self._demand(who, client_id, datagram)

    async def repeat(self, who: str) -> None:
        """The last command of this operator once more, with the same id."""
        if who in self._last:
            await self._last[who]()

    def datagram(self, who: str, data: bytes) -> None:
        """Something that need not be a command."""
        self._send(who, data)

    def stop(self, who: str) -> None:
        """Presses Stop: daemon and node hear it."""
        self._link.publish(f"stop/{who}", Beat(number=0, session="", alive=0.0, sent=0.0))

    async def _ask(self, who: str, command: Command) -> None:
        key = f"cmd/{who}/{command.branch}/{command.operation}"
        try:
            verdict = await self._link.request(key, command, Verdict, PATIENCE)
        except PcmrsError:
            return  # nobody knows: the operator looks at the state
        self.acknowledged(command, verdict)

    async def _demand(self, who: str, client_id: str, datagram: bytes) -> None:
        answer = self._answers.setdefault(client_id, asyncio.get_running_loop().create_future())
        interval, waited = REPEAT_AFTER, 0.0
        while not answer.done() and waited < PATIENCE:
            self._send(who, datagram)
            await asyncio.wait([answer], timeout=interval)
            waited, interval = waited + interval, 2.0 * interval

    def _send(self, who: str, data: bytes) -> None:
        daemon = self.cell.daemon
        if daemon is None:
            return
        receive, link, port = daemon.receive, daemon.link, PORTS[who]
        self._link.send(link, receive, port, data, lambda text: link.send(self._link, self._answered, text), None)

    def _answered(self, text: str) -> None:
        try:
            client_id, verdict = parse_reply(text.encode("ascii"))
        except PayloadError:
            return
        answer = self._answers.get(client_id)
        if answer is not None and not answer.done():
            answer.set_result(verdict)

    def _see(self, _key: str, snapshot: Snapshot) -> None:
        self.snapshot = snapshot


def _nowhere(_text: str) -> None:
    """Such a client does not listen for verdicts."""
