"""Uploads to a console by a program: nobody has looked at them before they are sent."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterable
from contextlib import suppress
from typing import Final

from pcmrs.testing.driving import PATIENCE
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.consoles import RunningConsole

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

    async def send(self, content: bytes) -> int:
        """Sends a file; returns the status, 0 where the connection is ended instead."""
        body = _BEGIN + content + _END
        status, _ = await self._post(_length(len(body)), [body])
        return status

    async def send_without_length(self, content: bytes) -> tuple[int, str]:
        """Sends a file in HTTP's form of a body without a length; returns status and text of the answer."""
        body = (b"%x\r\n%b\r\n" % (len(piece), piece) for piece in (_BEGIN, content, _END))
        return await self._post("Transfer-Encoding: chunked", [*body, b"0\r\n\r\n"])

    async def announce(self, length: int) -> tuple[int, str]:
        """Sends the head of an upload of so many bytes, and none of them; returns status and text of the answer."""
        return await self._post(_length(length), [])

    async def _post(self, header: str, body: Iterable[bytes]) -> tuple[int, str]:
        status, answer = await self._console.request(f"POST {self._place}", _FORM, header, body=body)
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


def _length(length: int) -> str:
    return f"Content-Length: {length}"
