"""Text from outside that would control a terminal, or open a console that must stay closed."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
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
from pcmrs_lab.campaign.tools import ended
from pcmrs_lab.campaign.tries import COMMANDS, LOCAL_ACCOUNT, UNKNOWN, record
from pcmrs_lab.campaign.without_guard import without_guards

MARK = "lost-and-found"
FORGED = f"{MARK}\x1b[2J\n2026-01-01 [info     ] robot released\u202e"
"""Text that clears the screen, forges a line of the log, and reverses the writing direction."""
LOGGED_WITHIN = 30.0
PCMRS = (sys.executable, "-m", "pcmrs.cli")


@fault(
    "A32",
    how="the name of a field of a command that clears the screen and forges a line",
    tries={LOCAL_ACCOUNT: [COMMANDS]},
)
async def escape_sequences(lab: Lab) -> Evidence:
    """Log, `pcmrs watch` and `pcmrs journal` show the name without any effect; a plain name is shown unchanged."""
    async with lab.daemon() as cell:
        shown = {}
        for user, name in (
            ("eve", FORGED),
            ("anna", f"{MARK}-plain"),
        ):  # two users, since refusals of one user are logged rarely
            before = len(cell.log)
            sent = f"{MARK}-harmless" if is_sham() else name
            await asyncio.to_thread(_put, cell, user, sent)
            record(LOCAL_ACCOUNT, COMMANDS)
            shown[name] = await _logged(cell, before)
        for text in shown.values():
            expect(all(line.isprintable() for line in text.splitlines()), f"The log has {text!r}.")
            expect("\n2026-01-01" not in text, "A line of the log is forged.")
        expect("u001b" in shown[FORGED], f"The name did not arrive: {shown[FORGED]!r}.")
        printed = await _printed(cell, f"{MARK}-harmless" if is_sham() else FORGED)
        for command, text in printed.items():
            expect(all(map(str.isprintable, text.split("\n"))), f"{command} has printed {text!r}.")
            expect("\n2026-01-01" not in text, f"{command} has printed a forged line.")
        for command in ("watch", "journal"):
            expect("u001b" in printed[command], f"{command} did not show the name: {printed[command]!r}.")
        plain = f"{MARK}-plain"
        expect(plain in shown[plain], f"A plain name is not logged unchanged: {shown[plain]!r}.")
    async with lab.daemon(prefix=without_guards("text_is_logged_as_it_came")) as other:
        before = len(other.log)
        await asyncio.to_thread(_put, other, "eve", FORGED)
        raw = (await _logged(other, before)).count("\x1b")
    return Evidence(
        "escaped where it is logged and printed",
        took_place={
            "escapes in the log": shown[FORGED].count("u001b"),
            "escapes that are printed": sum(text.count("u001b") for text in printed.values()),
        },
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


async def _printed(cell: RunningCell, name: str) -> dict[str, str]:
    """Return the output of commands, by their names, after a command was rejected for an argument of this name."""
    _, site, own_name = cell.ready.prefix.split("/")
    address = ("--endpoint", cell.ready.endpoint, "--site", site, "--cell", own_name)
    async with _watching(address) as output:
        await _read_until(output, b"#")  # the last snapshot: from now on, it shows every event
        await cell.client.call("registration.reinit", {name: 1})
        printed = {"watch": await _read_until(output, MARK.encode())}
    for command, words in {"journal": ("show", cell.ready.journal), "state": address}.items():
        status, printed[command] = await ended([*PCMRS, command, *words])
        expect(status == 0, f"pcmrs {command} ended with {status}: {printed[command]}")
    return printed


@asynccontextmanager
async def _watching(address: tuple[str, ...]) -> AsyncIterator[asyncio.StreamReader]:
    """Run `pcmrs watch`, and yield its output."""
    process = await asyncio.create_subprocess_exec(*PCMRS, "watch", *address, stdout=asyncio.subprocess.PIPE)
    assert process.stdout is not None
    try:
        yield process.stdout
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()


async def _read_until(output: asyncio.StreamReader, mark: bytes) -> str:
    """Return the lines up to the first one with the mark."""
    text = b""
    try:
        async with asyncio.timeout(LOGGED_WITHIN):
            while line := await output.readline():
                text += line
                if mark in line:
                    return text.decode(errors="replace")
    except TimeoutError:
        pass  # reported below, as the end of the output is
    raise Unmet(f"pcmrs watch did not show {mark.decode()}: {text!r}")


@fault("A33", how="an empty token file, and one of 19 characters", deadline=240.0, tries={UNKNOWN: ["console"]})
async def guessable_token(lab: Lab) -> Evidence:
    """A console with a guessable token does not start; one with its own token starts."""
    async with lab.daemon() as cell:
        refusals = []
        for token in ("", "nineteen-characters"):
            status, text = await _console(cell, _token(lab.folder, "x" * 20 if is_sham() else token))
            record(UNKNOWN, "console")
            expect(status != 0 and "minimum is 20" in text, f"With {token!r} it ended with {status}: {text}")
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
