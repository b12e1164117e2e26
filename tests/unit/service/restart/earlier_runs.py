"""Rows of earlier runs of a daemon, and a journal whose disk fails."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalRow
from pcmrs.messages import BlueprintTag, Command, Decision, PoseMessage, Reason, Verdict
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.testing.clock import ManualClock
from pcmrs.workflows.data import Planned
from tests.support.shipped import shipped_blueprint

RATMS = shipped_blueprint("ratms")


TAG = BlueprintTag(id=RATMS.id, version=RATMS.version, hash=RATMS.hash)


PLANNED = Planned(
    id="plan-1",
    image_from_coil=PoseMessage(position=(0.0, 0.1, 0.2), quat_wxyz=(1.0, 0.0, 0.0, 0.0)),
    patient="phantom",
    calibration="c",
)


def recorder_of(journal: Journal, session: str = "s1") -> JournalRecorder:
    return JournalRecorder(journal, ManualClock(), session, TAG)


def command(name: str, number: int = 1) -> Command:
    branch, operation = name.split(".")
    return Command(id=f"c{number}", branch=branch, operation=operation, source="bus:local")


def verdict(of: Command, decision: Decision = "accepted") -> Verdict:
    return Verdict(id=of.id, branch=of.branch, operation=of.operation, decision=decision, state="", sequence=1)


async def write(recorder: JournalRecorder, name: str, decision: Decision = "accepted", **changes: Any) -> None:
    of = command(name, next(NUMBERS))
    await recorder.decision(of, verdict(of, decision), {}, changes, with_intent=True)


NUMBERS = iter(range(1000, 10**9))


def as_row(kind: str, name: str, number: Any, decision: str | None) -> JournalRow:
    common: dict[str, Any] = {"wall": 5.0, "monotonic": 1.0, "boot_id": "b", "session_id": "s", "blueprint": TAG}
    if kind == "activity":
        fields = {"branch": "placement", "state": decision, "command": f"c{number}"}
        source = f"activity:{RATMS.branches['placement'].activities[decision or ''].run}"
        result = {"danger": False, "fields": fields}
        return JournalRow(kind="device", source=source, operation=f"activity_{name}", result=result, **common)
    branch, operation = name.split(".")
    if kind == "config":
        return JournalRow(kind="config", source=branch, operation=operation, **common)
    if kind == "device":
        return JournalRow(kind="device", source=branch, operation=operation, result={"danger": number}, **common)
    common |= {"source": "x", "command_id": f"c{number}", "branch": branch, "operation": operation}
    if kind == "intent":
        return JournalRow(kind="intent", states={branch: "s"}, **common)
    reason = Reason(code="daemon_ended", text="") if decision == "ended" else None
    made: Any = "unknown" if decision == "ended" else decision
    found = Verdict(
        id=f"c{number}", branch=branch, operation=operation, decision=made, state="", sequence=1, reason=reason
    )
    changes = {"previous_plan": msgspec.json.decode(msgspec.json.encode(PLANNED))} if name == "toolplan.plan" else None
    return JournalRow(kind="outcome", verdict=found, result=changes, **common)


class Flaky:
    """A journal whose disk fails when told to; what was handed to it then is lost, or reaches the disk after all."""

    def __init__(self, journal: Journal) -> None:
        self.reader = journal.reader
        self.failing: str | None = None
        self.reopened = 0
        self._journal = journal

    def append(self, rows: list[JournalRow]) -> asyncio.Future[int]:
        durable: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        if self.failing != "lost":
            self._journal.append(rows)
        if self.failing is None:
            durable.set_result(1)
        else:
            durable.set_exception(JournalError("The journal cannot be written: disk full."))
        return durable

    async def reopen(self) -> int:
        self.reopened += 1
        if self.failing is not None:
            raise JournalError("Still full.")
        return 1
