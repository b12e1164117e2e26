"""Uploads to a console by a program: nobody has looked at them before they are sent."""

from __future__ import annotations

import asyncio
import itertools
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import Final

from pcmrs.campaign.consoles import RunningConsole
from pcmrs.campaign.driving import PATIENCE
from pcmrs.campaign.fault import Unmet

NAME: Final = "patient.stl"
"""Of every file."""
TAKEN: Final = 200
"""Status of the answer to an upload that was taken."""
_PLACE: Final = re.compile(rb"/_nicegui/client/[\w-]+/upload/\d+")
_BOUNDARY: Final = "lost-and-found"
_FORM: Final = f"Content-Type: multipart/form-data; boundary={_BOUNDARY}"
_BEGIN: Final = f'--{_BOUNDARY}\r\nContent-Disposition: form-data; name="file"; filename="{NAME}"\r\n\r\n'.encode()
_END: Final = f"\r\n--{_BOUNDARY}--\r\n".encode()


class Uploader:
    """Sends files to the place that a page has for them.

    Args:
        console: Takes them.
        place: Path of that place.
    """

    def __init__(self, console: RunningConsole, place: str) -> None:
        self._console = console
        self._place = place

    async def send(self, pieces: Iterable[bytes]) -> int:
        """Sends a file in pieces, without its length; returns the status, 0 where the connection is ended instead."""
        body = _chunked(itertools.chain((_BEGIN,), pieces, (_END,)))
        status, _ = await self._console.request(f"POST {self._place}", _FORM, "Transfer-Encoding: chunked", body=body)
        return status

    async def announce(self, length: int) -> tuple[int, str]:
        """Sends the head of an upload of so many bytes, and none of them; returns status and text of the answer."""
        status, answer = await self._console.request(f"POST {self._place}", _FORM, f"Content-Length: {length}")
        return status, answer.decode(errors="replace")


async def uploader(console: RunningConsole) -> Uploader:
    """Asks for a page as a browser does, and finds the place for files in it.

    Raises:
        Unmet: There is none within `PATIENCE`: the console does not reach the daemon.
    """
    with suppress(TimeoutError):
        async with asyncio.timeout(PATIENCE):
            while True:
                _, page = await console.request("GET /")
                if found := _PLACE.search(page):
                    return Uploader(console, found.group().decode())
                await asyncio.sleep(0.5)
    raise Unmet(f"The page has no place for files within {PATIENCE:g} s.")


def _chunked(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """HTTP's form of a body without a length."""
    for piece in pieces:
        yield b"%x\r\n%b\r\n" % (len(piece), piece)
    yield b"0\r\n\r\n"
