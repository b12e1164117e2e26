"""What is asked of a daemon while its disk fails, and of its journal afterwards."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pcmrs.errors import UnknownOutcomeError
from pcmrs.journal import JournalReader
from pcmrs.messages import Verdict
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.driving import PATIENCE
from pcmrs_lab.campaign.checks import expect

SOURCE = "bus:local"


@dataclass
class Asked:
    """Commands to one cell, each with its id, and what was answered.

    Attributes:
        verdicts: By id; only those that came.
    """

    cell: RunningCell
    verdicts: dict[str, Verdict] = field(default_factory=dict)
    _number: int = 0

    async def ask(self, name: str = "registration.reinit", **arguments: Any) -> Verdict | None:
        """Asks for an operation; None when no verdict came in time."""
        self._number += 1
        command = f"durable{self._number}"
        try:
            verdict = await self.cell.client.call(name, arguments, id=command, timeout=PATIENCE)
        except UnknownOutcomeError:
            return None
        self.verdicts[command] = verdict
        return verdict

    async def degraded(self) -> dict[str, Any]:
        """Response D: a change of state is refused, Stop and status work.

        Raises:
            Unmet: It was not so.
        """
        verdict = await self.ask()
        expect(verdict is None or verdict.decision != "accepted", "A change of state was accepted.")
        await self.cell.client.stop()
        snapshot = await self.cell.client.state()
        expect(self.cell.process.returncode is None, "The daemon has ended.")
        expect(snapshot.latched, "Stop has not latched.")
        refusal = await self.ask()  # the first may be unknown: it was being written when the disk failed
        said = "not answered" if refusal is None else refusal.decision
        expect(said == "rejected", f"A change of state was {said}, must be rejected.")
        reason = refusal.reason.code if refusal is not None and refusal.reason is not None else ""
        return {"refused_as": reason, "latched": snapshot.latched}

    async def recovers(self, within: float = PATIENCE) -> bool:
        """Whether a change of state is accepted again, s of the machine."""
        clock = asyncio.get_running_loop().time
        end = clock() + within
        while clock() < end and self.cell.process.returncode is None:
            verdict = await self.ask()
            if verdict is not None and verdict.decision == "accepted":
                return True
            await asyncio.sleep(0.2)
        return False

    def check_kept(self, journal: Path) -> int:
        """Every accepted verdict that was answered is in the journal, word for word; returns how many.

        Raises:
            Unmet: It was not so.
            JournalError: It cannot be read.
        """
        accepted = {command: verdict for command, verdict in self.verdicts.items() if verdict.decision == "accepted"}
        with JournalReader(journal) as reader:
            lost = [command for command, verdict in accepted.items() if reader.verdict_of(SOURCE, command) != verdict]
        expect(not lost, f"{len(lost)} of {len(accepted)} acknowledged decisions are not in the journal.")
        return len(accepted)
