"""Commands to a daemon while its disk fails, and checks of its journal afterwards."""

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
class AnsweredCommands:
    """Commands to one cell, each with its id, and their verdicts.

    Attributes:
        verdicts: Verdicts by command id; commands without an answer are missing.
    """

    cell: RunningCell
    verdicts: dict[str, Verdict] = field(default_factory=dict)
    _number: int = 0

    async def request(self, name: str = "registration.reinit", **arguments: Any) -> Verdict | None:
        """Request an operation and return its verdict; None if none came in time.

        Args:
            name: Operation, ``branch.operation``.
            arguments: Arguments of the operation.
        """
        self._number += 1
        command = f"durable{self._number}"
        try:
            verdict = await self.cell.client.call(name, arguments, id=command, timeout=PATIENCE)
        except UnknownOutcomeError:
            return None
        self.verdicts[command] = verdict
        return verdict

    async def degraded(self) -> dict[str, Any]:
        """Check response D: a change of state is refused, Stop and status work.

        Returns:
            Details for the report.

        Raises:
            Unmet: The response was not as required.
        """
        verdict = await self.request()
        expect(verdict is None or verdict.decision != "accepted", "A change of state was accepted.")
        await self.cell.client.stop()
        snapshot = await self.cell.client.state()
        expect(self.cell.process.returncode is None, "The daemon has ended.")
        expect(snapshot.latched, "Stop did not latch.")
        refusal = await self.request()  # the outcome of the first may be unknown: the disk failed while it was written
        outcome = "not answered" if refusal is None else refusal.decision
        expect(outcome == "rejected", f"A change of state was {outcome}; expected rejected.")
        reason = refusal.reason.code if refusal is not None and refusal.reason is not None else ""
        return {"refused_as": reason, "latched": snapshot.latched}

    async def recovers(self, within: float = PATIENCE) -> bool:
        """Return whether a change of state is accepted again.

        Args:
            within: Time limit, s of the machine.
        """
        clock = asyncio.get_running_loop().time
        end = clock() + within
        while clock() < end and self.cell.process.returncode is None:
            verdict = await self.request()
            if verdict is not None and verdict.decision == "accepted":
                return True
            await asyncio.sleep(0.2)
        return False

    def check_journalled(self, journal: Path) -> int:
        """Check that the journal has every accepted verdict unchanged, and return how many there are.

        Raises:
            Unmet: A verdict is missing or different.
            JournalError: The journal cannot be read.
        """
        accepted = {command: verdict for command, verdict in self.verdicts.items() if verdict.decision == "accepted"}
        with JournalReader(journal) as reader:
            lost = [command for command, verdict in accepted.items() if reader.verdict_of(SOURCE, command) != verdict]
        expect(not lost, f"{len(lost)} of {len(accepted)} acknowledged decisions are not in the journal.")
        return len(accepted)
