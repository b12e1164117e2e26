"""Files that a program uploads to the console: longer than the limit, or in its hands when it is killed."""

from __future__ import annotations

import asyncio
import itertools
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Final

from pcmrs.background import meanwhile
from pcmrs.campaign.checks import expect
from pcmrs.campaign.consoles import CONSOLE, RunningConsole, running_console
from pcmrs.campaign.fault import Evidence, Unmet, fault
from pcmrs.campaign.lab import Lab
from pcmrs.campaign.proc import process_state
from pcmrs.campaign.sham import bring_about, is_sham
from pcmrs.campaign.uploading import TAKEN, Uploader, uploader
from pcmrs.campaign.waiting import until_true
from pcmrs.console.planning.files import LARGEST
from pcmrs.experiment.process import free_port

PIECE: Final = bytes(2**20)
LIMIT: Final = LARGEST + len(PIECE)
"""Bytes that the server takes: those of the files, and what a form may add."""
PIECES: Final = LIMIT // len(PIECE) + 8
"""Of a file that is too long."""
TOO_LARGE: Final = 413
UPLOADS: Final = 20
ALONE: Final = 1.0
"""So long no console starts after one was killed, s of the machine."""
LOOKS: Final = 0.02
"""Seconds between two looks at what is stored."""


@fault("A37", how="a request that says to be longer than the limit, of a program that has the token", needs=[CONSOLE])
async def announced_too_long(lab: Lab) -> Evidence:
    """It is refused before anything of it is sent."""
    async with _upload(lab) as (_, own):
        taken = await own.send([PIECE])
        expect(taken == TAKEN, f"A short upload was answered {taken}.")
        status, text = (await own.send([PIECE]), "") if is_sham() else await own.announce(LIMIT + 1)
        expect(status == TOO_LARGE and str(LIMIT) in text, f"It was answered {status}: {text}")
    return Evidence(
        "refused, with the limit",
        took_place={"answered_by_the_server": status},
        control={"a_short_one": taken},
    )


@fault("A37", how="a request without a length, in pieces, of a program that has the token", needs=[CONSOLE])
async def pieces_without_end(lab: Lab) -> Evidence:
    """The server ends the connection at the limit, keeps nothing, and serves others."""
    stored: list[int] = []
    async with _upload(lab) as (console, own):
        async with meanwhile(_watch(console, stored)):
            status = await own.send(itertools.repeat(PIECE, 1 if is_sham() else PIECES))
        expect(status != TAKEN, "It was taken.")
        expect(LARGEST // 2 < max(stored) <= LIMIT, f"{max(stored)} bytes were stored; the limit is {LIMIT}.")
        await until_true(lambda: not (_open(console) or _left(console)), "What came of it is not removed")
        taken = await own.send([PIECE])
        expect(taken == TAKEN, f"A short upload was answered {taken}.")
    return Evidence(
        "ended at the limit",
        took_place={"bytes_stored_when_it_was_ended": max(stored)},
        control={"a_short_one": taken},
        details={"limit": LIMIT, "status": status},
    )


@fault("A38", how="SIGKILL to a console that has the file of an upload read", needs=[CONSOLE])
async def killed_with_a_file(lab: Lab) -> Evidence:
    """The next console that starts removes the file, at whatever port; nobody does before."""
    async with lab.cell(anew=False) as cell:
        async with running_console(cell, lab.folder, free_port()) as console:
            own = await uploader(console)
            await _until_stopped_with_a_file(console, own)
            bring_about(console.process.kill)
            await until_true(lambda: console.process.returncode is not None, "The console has not ended")
        ended, left = console.process.returncode, _bytes(_left(console))
        expect(ended == -signal.SIGKILL, f"It has ended with {ended}.")
        await asyncio.sleep(ALONE)
        kept = _bytes(_left(console))
        async with running_console(cell, lab.folder, free_port()):
            found = _left(console)
        expect(not found, f"After the next start there are {[path.name for path in found]}.")
    return Evidence(
        "removed at the next start",
        took_place={"bytes_left_by_the_killed_one": left},
        control={"bytes_before_the_next_start": kept},
        details={"status": ended},
    )


async def _until_stopped_with_a_file(console: RunningConsole, own: Uploader) -> None:
    """Uploads until the console is stopped while the file is there: it removes it as soon as it has read it."""
    for _ in range(UPLOADS):
        await own.send([PIECE])
        await until_true(lambda: _bytes(_left(console)) > 0, "The file is not to be seen")
        bring_about(lambda: console.process.send_signal(signal.SIGSTOP))
        if not is_sham():
            await until_true(lambda: process_state(console.process.pid) == "T", "The console is not stopped")
        if _bytes(_left(console)) > 0:
            return
        console.process.send_signal(signal.SIGCONT)
    raise Unmet(f"Of {UPLOADS} files none was there any more when the console was stopped.")


@asynccontextmanager
async def _upload(lab: Lab) -> AsyncIterator[tuple[RunningConsole, Uploader]]:
    """A console, and the place that it has for files."""
    async with lab.cell(anew=False) as cell, running_console(cell, lab.folder, free_port()) as console:
        yield console, await uploader(console)


def _left(console: RunningConsole) -> list[Path]:
    """Files in its folder."""
    return [path for path in console.uploads.rglob("*") if path.is_file()]


def _bytes(paths: list[Path]) -> int:
    return sum(path.stat().st_size for path in paths)


def _open(console: RunningConsole) -> list[int]:
    """Sizes of the files of its folder that its process has open, those without a name too, by its kernel."""
    sizes = []
    for link in Path(f"/proc/{console.process.pid}/fd").iterdir():
        with suppress(OSError):  # it may have been closed meanwhile
            if link.readlink().is_relative_to(console.uploads):
                sizes.append(link.stat().st_size)
    return sizes


async def _watch(console: RunningConsole, stored: list[int]) -> None:
    """Notes what its process has stored."""
    while True:
        stored.append(max(_open(console), default=0))
        await asyncio.sleep(LOOKS)
