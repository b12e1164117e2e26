"""Consoles as processes, and requests to them that do not come from their page."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import AsyncIterator, Iterable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pcmrs.console.guard import cookie_name
from pcmrs.console.settings import HOST, UPLOADS
from pcmrs.files import SECRET
from pcmrs.service.processes.child import end_child
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.errors import Unmet
from pcmrs.testing.needs import module
from pcmrs_lab.campaign.checks import expect

CONSOLE: Final = module("nicegui")
"""Requirement of a console on the machine."""
START_TIME: Final = 60.0
END_TIME: Final = 15.0
ANSWERED_WITHIN: Final = 60.0
"""Time limit for an answer, s of the machine."""
_TOKEN: Final = "token-of-the-campaign"  # noqa: S105  # of consoles that the campaign starts


@dataclass(frozen=True, slots=True)
class RunningConsole:
    """Console that serves its page.

    Attributes:
        process: Process of the console.
        port: Port on loopback.
        uploads: Folder for uploaded files, shared by consoles at all ports.
    """

    process: asyncio.subprocess.Process
    port: int
    uploads: Path

    async def request(self, head: str, *headers: str, body: Iterable[bytes] = ()) -> tuple[int, bytes]:
        """Send a request as a program that has the token, and return status and body of the answer.

        Args:
            head: Method and path.
            headers: Further header lines.
            body: Pieces of the body, sent unchanged.

        Returns:
            Status and body; 0 and an empty body if the connection ends without an answer.

        Raises:
            Unmet: The request is not answered in time.
        """
        name = f"{HOST}:{self.port}"
        own = (f"{head} HTTP/1.1", f"Host: {name}", f"Cookie: {cookie_name(name)}={_TOKEN}", "Connection: close")
        reader, writer = await asyncio.open_connection(HOST, self.port)
        try:
            async with asyncio.timeout(ANSWERED_WITHIN):
                writer.write("\r\n".join((*own, *headers, "", "")).encode())
                for piece in body:
                    writer.write(piece)
                    await writer.drain()
                status_line, _, answer = (await reader.read()).partition(b"\r\n\r\n")
        except TimeoutError:
            raise Unmet(f"{head} was not answered within {ANSWERED_WITHIN:g} s.") from None
        except ConnectionError:
            return 0, b""
        finally:
            writer.close()
        return (int(status_line.split()[1]) if status_line else 0), answer


def console_command(cell: RunningCell, port: int, token: Path) -> list[str]:
    """Return the command line of a console for a cell.

    Args:
        cell: Cell that the console shows.
        port: Port on loopback; 0 for a free one.
        token: File with the token.
    """
    _, site, name = cell.ready.prefix.split("/")
    words = ("--endpoint", cell.ready.endpoint, "--site", site, "--cell", name, "--port", str(port), "--json")
    return [sys.executable, "-m", "pcmrs.cli", "console", *words, "--token-file", str(token)]


@asynccontextmanager
async def running_console(
    cell: RunningCell, folder: Path, port: int, prefix: Sequence[str] = ()
) -> AsyncIterator[RunningConsole]:
    """Run a console of a cell for the length of the context.

    Args:
        cell: Cell that the console shows.
        folder: Folder for its token and its log, used in place of the user's cache.
        port: Free port on loopback.
        prefix: Words before the command line.

    Yields:
        Running console.

    Raises:
        Unmet: The console does not serve within `START_TIME`.
    """
    token = folder / "console.token"
    token.write_text(_TOKEN)
    token.chmod(SECRET)
    command, environment = console_command(cell, port, token), {**os.environ, "XDG_CACHE_HOME": str(folder)}
    with (folder / "console.log").open("ab") as log:
        process = await asyncio.create_subprocess_exec(
            *prefix, *command, stdout=asyncio.subprocess.PIPE, stderr=log, env=environment
        )
    try:
        await _until_served(process)
        yield RunningConsole(process, port, folder / "pcmrs" / UPLOADS)
    finally:
        if process.returncode is None:
            process.terminate()
        await end_child(process, END_TIME)


async def _until_served(process: asyncio.subprocess.Process) -> None:
    assert process.stdout is not None
    try:
        async with asyncio.timeout(START_TIME):
            line = await process.stdout.readline()
    except TimeoutError:
        raise Unmet(f"The console did not serve its page within {START_TIME:g} s.") from None
    expect(b'"url"' in line, f"The console did not start: {line.decode(errors='replace')}")
