"""Programs that faults need: a missing one makes a fault not run, never passed."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence

from pcmrs.testing.needs import Need
from pcmrs_lab.campaign.fault import NotRun


def require(needs: Iterable[Need]) -> None:
    """Raise `NotRun`, with the names of the missing ones, unless this machine meets all requirements."""
    missing = [need.name for need in needs if not need.is_met()]
    if missing:
        raise NotRun(f"missing here: {', '.join(missing)}; `make tools` installs what can be installed")


async def ended(words: Sequence[str]) -> tuple[int, str]:
    """Run a program to its end and return its exit status and output."""
    process = await asyncio.create_subprocess_exec(
        *words, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )
    output, _ = await process.communicate()
    return process.returncode or 0, output.decode(errors="replace")


async def tool(words: Sequence[str]) -> str:
    """Run a program of the machine and return its output.

    Raises:
        NotRun: The program fails on this machine; the text has its output.
    """
    status, output = await ended(words)
    if status != 0:
        raise NotRun(f"{' '.join(words)} failed here: {output.strip()}")
    return output
