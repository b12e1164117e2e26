"""Files that a program uploads to the console: longer than the limit, or still there when it is killed."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final

from pcmrs.console.planning.files import LARGEST
from pcmrs.testing.daemon import free_port
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.checks import expect
from pcmrs_lab.campaign.consoles import CONSOLE, RunningConsole, running_console
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.samples import process_state
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham
from pcmrs_lab.campaign.tries import LOCAL_ACCOUNT, record
from pcmrs_lab.campaign.uploading import TAKEN, Uploader, uploader
from pcmrs_lab.campaign.waiting import until_true
from pcmrs_lab.campaign.without_guard import without_guards

FILE: Final = bytes(1000)
LIMIT: Final = LARGEST + 2**20
"""Number of bytes that the server accepts: the largest file, and the overhead of a form."""
TOO_LARGE: Final = 413
LENGTH_REQUIRED: Final = 411
UPLOADS: Final = 20
UNANSWERED: Final = 5.0
"""Time without an answer after which the server counts as waiting for the body, s of the machine."""


@fault(
    "A37",
    how="a request with a length above the limit, from a program with the token",
    needs=[CONSOLE],
    deadline=240.0,
    tries={LOCAL_ACCOUNT: ["uploads"]},
)
async def announced_too_long(lab: Lab) -> Evidence:
    """It is refused before any of it is sent."""
    async with _upload(lab) as (_, own):
        taken = await own.send(FILE)
        expect(taken == TAKEN, f"A short upload was answered {taken}.")
        status, text = (await own.send(FILE), "") if is_sham() else await own.announce(LIMIT + 1)
        record(LOCAL_ACCOUNT, "uploads")
        expect(status == TOO_LARGE and str(LIMIT) in text, f"It was answered {status}: {text}")
    async with _upload(lab, "uploads_of_any_length") as (_, own):
        waits = await _waits_for_the_body(own)
    return Evidence(
        "refused, with the limit",
        took_place={"answered_by_the_server": status},
        control_kind="mutant",
        control={"waits_for_the_body_without_the_guard": waits, "a_short_one": taken},
    )


@fault(
    "A37",
    how="a request without a length, from a program with the token",
    needs=[CONSOLE],
    deadline=240.0,
    tries={LOCAL_ACCOUNT: ["uploads"]},
)
async def without_length(lab: Lab) -> Evidence:
    """It is refused unread, since its end is unknown."""
    async with _upload(lab) as (_, own):
        taken = await own.send(FILE)
        expect(taken == TAKEN, f"A short upload was answered {taken}.")
        status, text = (await own.send(FILE), "") if is_sham() else await own.send_without_length(FILE)
        record(LOCAL_ACCOUNT, "uploads")
        expect(status == LENGTH_REQUIRED and "Content-Length" in text, f"It was answered {status}: {text}")
    async with _upload(lab, "uploads_without_a_length") as (_, own):
        read, text = await own.send_without_length(FILE)
        expect(read == TAKEN, f"Without the guard it was answered {read}: {text}")
    return Evidence(
        "refused, with what is missing",
        took_place={"answered_by_the_server": status},
        control_kind="mutant",
        control={"read_without_the_guard": read, "the_same_with_its_length": taken},
    )


@fault(
    "A38",
    how="SIGKILL of a console while it reads an uploaded file",
    needs=[CONSOLE],
    deadline=240.0,
    tries={LOCAL_ACCOUNT: ["uploads"]},
)
async def killed_with_a_file(lab: Lab) -> Evidence:
    """The next console that starts, at any port, removes the file."""
    async with lab.cell(fresh=False) as cell:
        async with running_console(cell, lab.folder, free_port()) as console:
            own = await uploader(console)
            await _until_stopped_with_a_file(console, own)
            inject_unless_sham(console.process.kill)
            record(LOCAL_ACCOUNT, "uploads")
            await until_true(lambda: console.process.returncode is not None, "The console has not ended")
        ended, left = console.process.returncode, _bytes(_left(console))
        expect(ended == -signal.SIGKILL, f"It has ended with {ended}.")
        async with running_console(cell, lab.folder, free_port(), without_guards("files_of_a_killed_console_stay")):
            kept = _bytes(_left(console))
        async with running_console(cell, lab.folder, free_port()):
            found = _left(console)
        expect(not found, f"After the next start there are {[path.name for path in found]}.")
    return Evidence(
        "removed at the next start",
        took_place={"bytes_left_by_the_killed_one": left},
        control_kind="mutant",
        control={"bytes_left_by_a_start_without_the_guard": kept},
        details={"status": ended},
    )


async def _until_stopped_with_a_file(console: RunningConsole, own: Uploader) -> None:
    """Upload until the console is stopped while the file exists: it removes the file as soon as it has read it."""
    for _ in range(UPLOADS):
        await own.send(FILE)
        await until_true(lambda: _bytes(_left(console)) > 0, "The file did not appear")
        inject_unless_sham(lambda: console.process.send_signal(signal.SIGSTOP))
        if not is_sham():
            await until_true(lambda: process_state(console.process.pid) == "T", "The console is not stopped")
        if _bytes(_left(console)) > 0:
            return
        console.process.send_signal(signal.SIGCONT)
    raise Unmet(f"None of {UPLOADS} files existed any more when the console was stopped.")


async def _waits_for_the_body(own: Uploader) -> bool:
    """Announce a body above the limit, send none of it, and return whether the server waits for it."""
    try:
        async with asyncio.timeout(UNANSWERED):
            status, text = await own.announce(LIMIT + 1)
    except TimeoutError:
        return True
    raise Unmet(f"Without the guard it was answered {status}: {text}")


@asynccontextmanager
async def _upload(lab: Lab, *without: str) -> AsyncIterator[tuple[RunningConsole, Uploader]]:
    """Start a console without some of its guards, and yield it with its upload address."""
    prefix = without_guards(*without) if without else ()
    async with lab.cell(fresh=False) as cell, running_console(cell, lab.folder, free_port(), prefix) as console:
        yield console, await uploader(console)


def _left(console: RunningConsole) -> list[Path]:
    """Return the files in its folder."""
    return [path for path in console.uploads.rglob("*") if path.is_file()]


def _bytes(paths: list[Path]) -> int:
    return sum(path.stat().st_size for path in paths)
