"""What faults need of the machine: what it does not have makes a fault not run, never passed."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence

from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.needs import Need


def require(needs: Iterable[Need]) -> None:
    """Raises `NotRun`, with the names of what is missing, unless this machine meets all of the needs."""
    missing = [need.name for need in needs if not need.is_met()]
    if missing:
        raise NotRun(f"missing here: {', '.join(missing)}; `make tools` installs what can be installed")


async def ended(words: Sequence[str]) -> tuple[int, str]:
    """Runs a program to its end and returns its exit status and what it printed."""
    process = await asyncio.create_subprocess_exec(
        *words, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )
    output, _ = await process.communicate()
    return process.returncode or 0, output.decode(errors="replace")


async def tool(words: Sequence[str]) -> str:
    """Runs a program of the machine and returns what it printed.

    Raises:
        NotRun: This machine does not let it do that; the text has its last words.
    """
    status, output = await ended(words)
    if status != 0:
        raise NotRun(f"{' '.join(words)} failed here: {output.strip()}")
    return output
