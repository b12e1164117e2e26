"""A client of a daemon that answers as a test says, without a bus; what it is told nothing of, it accepts."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping
from types import SimpleNamespace
from typing import Any, cast

import msgspec

from pcmrs.client import Client
from pcmrs.errors import UnknownOutcomeError
from pcmrs.journal import JournalRow
from pcmrs.messages import BlueprintTag, Decision, Reason, Running, Snapshot, StopState, Verdict
from pcmrs.workflows.data import as_message
from pcmrs.workflows.settings import SIMULATED_TOOL_MARKER_FROM_TOOL_TIP
from tests.support.health_facts import WELL

TAG = BlueprintTag(id="ratms", version="1", hash="ab" * 32)
SHOWN_EVERY = 0.1
"""Time between two snapshots that `watch` shows, s of the loop."""

Answer = tuple[Decision, Reason | None]


def snapshot(*, latched: bool = False, sequence: int = 1, **branches: str) -> Snapshot:
    return Snapshot(sequence=sequence, branches=branches, flags={}, running=[], latched=latched, blueprint=TAG)


def verdict(name: str = "placement.approach", decision: Decision = "accepted", code: str = "", **more: Any) -> Verdict:
    branch, _, operation = name.partition(".")
    reason = Reason(code=code, text=f"It is {code}.") if code else None
    given: dict[str, Any] = {"id": "1", "state": "", "sequence": 1, "reason": reason}
    return Verdict(branch=branch, operation=operation, decision=decision, **(given | more))


def rejected(code: str, **fields: Any) -> Answer:
    return "rejected", Reason(code=code, text=f"It is {code}.", fields=fields)


def failed(code: str, text: str = "") -> Answer:
    return "failed", Reason(code=code, text=text or f"It is {code}.")


class ScriptedClient:
    """A daemon that answers as it is told.

    Attributes:
        answers: By operation, in order; an operation without any is accepted.
        results: Of accepted operations.
        leads: State that an accepted operation leads to, by operation.
        devices: Answers of devices, by ``device.method``.
        calls: Operations and arguments, in order.
        rows: The journal: each decision, and what a test adds.
        handlers: Of `listen`, by key.
    """

    def __init__(self, **branches: str) -> None:
        self.answers: dict[str, list[Answer]] = {}
        self.results: dict[str, dict[str, Any]] = {}
        self.leads: dict[str, dict[str, str]] = {}
        self.devices: dict[str, Any] = {}
        self.branches = {"robot": "1", "placement": "retracted", "alignment": "1"} | branches
        self.calls: list[tuple[str, Mapping[str, Any]]] = []
        self.rows: list[JournalRow] = []
        self.handlers: dict[str, Callable[[Any], None]] = {}
        self.health_now = WELL
        self.running: list[Running] = []
        self.latched = False
        self.silent = False
        self.stop_state = StopState()
        self.sequence = 1

    async def setup(self) -> Any:
        """Of a cell with the simulated tool."""
        return SimpleNamespace(tool_marker_from_tool_tip=as_message(SIMULATED_TOOL_MARKER_FROM_TOOL_TIP.transform()))

    @property
    def asked(self) -> list[str]:
        return [name for name, _ in self.calls]

    @property
    def as_client(self) -> Client:
        return cast(Client, self)

    async def call(
        self, name: str, arguments: Mapping[str, Any] | None = None, *, id: str | None = None, timeout: float = 0.0
    ) -> Verdict:
        if self.silent:
            raise UnknownOutcomeError("The daemon does not answer.")
        self.calls.append((name, arguments or {}))
        branch, _, operation = name.partition(".")
        decision, reason = self.answers[name].pop(0) if self.answers.get(name) else ("accepted", None)
        if decision == "accepted":
            self.sequence += 1
            self.branches |= self.leads.get(name, {})
        decided = Verdict(
            id=id or str(len(self.calls)),
            branch=branch,
            operation=operation,
            decision=decision,
            state=self.branches.get(branch, ""),
            sequence=self.sequence,
            reason=reason,
            result=self.results.get(name) if decision == "accepted" else None,
        )
        self.rows.append(row(verdict=decided, arguments=dict(arguments or {})))
        return decided

    async def acknowledge(self, *, stop: int | None = None) -> Verdict:
        assert stop == self.stop_state.number, "the one that was shown"
        return await self.call("robot.acknowledge")

    async def stop(self, timeout: float = 0.0) -> None:
        if self.silent:
            raise UnknownOutcomeError("The daemon does not answer.")
        self.latched = True
        self.stop_state = msgspec.structs.replace(self.stop_state, number=self.stop_state.number + 1)

    async def state(self, timeout: float = 0.0) -> Snapshot:
        if self.silent:
            raise UnknownOutcomeError("The daemon does not answer.")
        shown = snapshot(latched=self.latched, sequence=self.sequence, **self.branches)
        return msgspec.structs.replace(shown, running=list(self.running), stop=self.stop_state)

    async def health(self) -> Any:
        return self.health_now

    async def watch(self) -> AsyncGenerator[Snapshot, None]:
        while True:
            yield await self.state()
            await asyncio.sleep(SHOWN_EVERY)

    def listen(self, key: str, kind: type, handler: Callable[[Any], None]) -> Callable[[], Awaitable[None]]:
        self.handlers[key] = handler

        async def end() -> None:
            self.handlers.pop(key, None)

        return end

    async def request_device(self, device: str, method: str, arguments: Mapping[str, Any] | None = None) -> Any:
        found = self.devices[f"{device}.{method}"]
        if isinstance(found, Exception):
            raise found
        return found


def row(kind: Any = "outcome", verdict: Verdict | None = None, **fields: Any) -> JournalRow:
    """A row of the journal; a verdict names branch, operation and command."""
    named: dict[str, Any] = {}
    if verdict is not None:
        named = {"branch": verdict.branch, "operation": verdict.operation, "command_id": verdict.id}
        named |= {"verdict": verdict, "source": "bus:local"}
    given: dict[str, Any] = {"wall": 1.8e9, "monotonic": 100.0, "boot_id": "b", "session_id": "s", "blueprint": TAG}
    return JournalRow(kind=kind, **(given | named | fields))
