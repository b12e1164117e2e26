"""Verification of the whole journal after the start: the start itself reads only its last part."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import msgspec
import structlog

from pcmrs.journal import JournalVerification
from pcmrs.killing import kill_and_wait
from pcmrs.messages import DeviceEvent

log = structlog.get_logger(__name__)

NICENESS = 19
"""Lowest priority: everything else on the machine goes first."""


async def audit(journal: Path, report: Callable[[DeviceEvent], None]) -> None:
    """Verify a journal in a child process, and report damage.

    Damage in old rows does not concern present motion, so nothing is held for it; but it is always reported.

    Args:
        journal: Journal file; it may be written meanwhile.
        report: Takes an event ``journal_damaged``.
    """
    try:
        found = await _verified(journal)
    except (OSError, msgspec.DecodeError) as error:
        log.warning("journal_not_verified", reason=str(error))
        return
    if found.sound:
        log.info("journal_verified", rows=found.rows)
        return
    text = (
        f"The journal is damaged: {' '.join(found.problems)} "
        "Nothing repairs it: `pcmrs journal export --good-part` saves what is good."
    )
    fields = {"rows": found.rows, "first_bad": found.first_bad, "missing": found.missing}
    report(DeviceEvent(device="daemon", code="journal_damaged", text=text, fields=fields))


async def _verified(journal: Path) -> JournalVerification:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "pcmrs.cli",
        "journal",
        "verify",
        str(journal),
        "--json",
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        start_new_session=True,  # a Ctrl-C at the terminal is the daemon's to handle
    )
    try:
        with suppress(ProcessLookupError):
            os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
        output, _ = await process.communicate()
    finally:
        if process.returncode is None:
            await kill_and_wait(process)
    return msgspec.json.decode(output, type=JournalVerification)
