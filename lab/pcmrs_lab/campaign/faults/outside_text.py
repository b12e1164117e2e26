"""Text from outside that would control a terminal, or open a console that must stay closed."""

from __future__ import annotations

import asyncio
from pathlib import Path

from pcmrs.bus.codec import pack_text
from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.files import SECRET
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.checks import expect
from pcmrs_lab.campaign.consoles import START_TIME, console_command
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.without_guard import without_guards

MARK = "lost-and-found"
FORGED = f"{MARK}\x1b[2J\n2026-01-01 [info     ] robot released\u202e"
"""Text that clears the screen, forges a line of the log, and reverses the writing direction."""
LOGGED_WITHIN = 30.0


@fault("A32", how="a field of a command on the bus whose name clears the screen and forges a line of the log")
async def escape_sequences(lab: Lab) -> Evidence:
    """The daemon logs and journals the name without any effect; a plain name is logged unchanged."""
    async with lab.daemon() as cell:
        shown = {}
        for user, name in (
            ("eve", FORGED),
            ("anna", f"{MARK}-plain"),
        ):  # two users, since refusals of one user are logged rarely
            before = len(cell.log)
            sent = f"{MARK}-harmless" if is_sham() else name
            await asyncio.to_thread(_put, cell, user, sent)
            shown[name] = await _logged(cell, before)
        for text in shown.values():
            expect(all(line.isprintable() for line in text.splitlines()), f"The log has {text!r}.")
            expect("\n2026-01-01" not in text, "A line of the log is forged.")
        expect("u001b" in shown[FORGED], f"The name did not arrive: {shown[FORGED]!r}.")
        plain = f"{MARK}-plain"
        expect(plain in shown[plain], f"A plain name is not logged unchanged: {shown[plain]!r}.")
    async with lab.daemon(prefix=without_guards("text_is_logged_as_it_came")) as other:
        before = len(other.log)
        await asyncio.to_thread(_put, other, "eve", FORGED)
        raw = (await _logged(other, before)).count("\x1b")
    return Evidence(
        "escaped where it is logged",
        took_place={"escapes in the log": shown[FORGED].count("u001b")},
        control_kind="mutant",
        control={
            "raw escapes in the log without the guard": raw,
            "times a plain name is logged as it is": shown[plain].count(plain),
        },
    )


def _put(cell: RunningCell, user: str, name: str) -> None:
    """Put a malformed command whose refusal names the field."""
    with open_session(BusSettings(endpoint=cell.ready.endpoint)) as session:
        session.put(f"{cell.ready.prefix}/cmd/{user}/registration/reinit", pack_text({name: 1}))


async def _logged(cell: RunningCell, before: int) -> str:
    try:
        async with asyncio.timeout(LOGGED_WITHIN):
            while True:
                text = cell.log[before:]
                if MARK in text and text.endswith("\n"):
                    return text
                await asyncio.sleep(0.05)
    except TimeoutError:
        raise Unmet(f"The daemon did not log the name: {cell.log[before:]!r}") from None


@fault("A33", how="an empty token file, and one of 19 characters", deadline=240.0)
async def guessable_token(lab: Lab) -> Evidence:
    """A console with a guessable token does not start; one with its own token starts."""
    async with lab.daemon() as cell:
        refusals = []
        for token in ("", "nineteen-characters"):
            status, text = await _console(cell, _token(lab.folder, "x" * 20 if is_sham() else token))
            expect(status != 0 and "limit is 20" in text, f"With {token!r} it ended with {status}: {text}")
            refusals.append(text.strip()[-200:])
        status, text = await _console(cell, _token(lab.folder, "x" * 20))
        expect('"url"' in text, f"With a good token it printed {text!r}, status {status}.")
    return Evidence(
        "refused to start, with the reason",
        took_place={"said of the token": refusals},
        control_kind="permitted",
        control={"20 characters open one": '"url"' in text},
    )


def _token(folder: Path, token: str) -> Path:
    file = folder / "token"
    file.write_text(token)
    file.chmod(SECRET)
    return file


async def _console(cell: RunningCell, token: Path) -> tuple[int, str]:
    """Return the exit status of a console, and its output until it was ready or ended."""
    command, pipe = console_command(cell, 0, token), asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(*command, stdout=pipe, stderr=asyncio.subprocess.STDOUT)
    assert process.stdout is not None
    text = b""
    try:
        async with asyncio.timeout(START_TIME):
            text = await process.stdout.readline()
            while text and b'"url"' not in text and (line := await process.stdout.readline()):
                text += line
    finally:
        if process.returncode is None and b'"url"' in text:
            process.terminate()
        status = await process.wait()
    return status, text.decode(errors="replace")
