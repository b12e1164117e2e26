"""Programs and rights that faults need of the machine; what is missing makes a fault not run, never passed."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Sequence

from pcmrs.campaign.fault import NotRun


def require_root(why: str) -> None:
    """Raises `NotRun` unless this process has the rights of root."""
    if os.geteuid() != 0:
        raise NotRun(f"{why} needs the rights of root.")


async def tool(words: Sequence[str]) -> str:
    """Runs a program of the machine and returns what it printed.

    Raises:
        NotRun: It is missing, or this machine does not let it do that; the text has its last words.
    """
    try:
        process = await asyncio.create_subprocess_exec(
            *words, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
        )
    except OSError as error:
        raise NotRun(f"{words[0]} cannot be run: {error.strerror}; `make tools` installs what faults need.") from None
    output, _ = await process.communicate()
    if process.returncode != 0:
        raise NotRun(f"{' '.join(words)} failed here: {output.decode(errors='replace').strip()}")
    return output.decode(errors="replace")
