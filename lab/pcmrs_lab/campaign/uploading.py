"""Uploads to a console by a program, which skips the checks of the page."""

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
"""Name of every uploaded file."""
TAKEN: Final = 200
"""Status of the answer to an accepted upload."""
# The path under which NiceGUI serves an upload element.
_PLACE: Final = re.compile(rb"/_nicegui/client/[\w-]+/upload/\d+")
_BOUNDARY: Final = "lost-and-found"
_FORM: Final = f"Content-Type: multipart/form-data; boundary={_BOUNDARY}"
_BEGIN: Final = f'--{_BOUNDARY}\r\nContent-Disposition: form-data; name="file"; filename="{NAME}"\r\n\r\n'.encode()
_END: Final = f"\r\n--{_BOUNDARY}--\r\n".encode()


class Uploader:
    """Sender of files to the upload address of a page.

    Args:
        console: Console that receives them.
        place: Path of the upload address.
    """

    def __init__(self, console: RunningConsole, place: str) -> None:
        self._console = console
        self._place = place

    async def send(self, content: bytes) -> int:
        """Send a file and return the status; 0 if the connection ends instead."""
        body = _BEGIN + content + _END
        status, _ = await self._post(_length(len(body)), [body])
        return status

    async def send_without_length(self, content: bytes) -> tuple[int, str]:
        """Send a file as a chunked HTTP body without a length, and return status and text of the answer."""
        body = (b"%x\r\n%b\r\n" % (len(piece), piece) for piece in (_BEGIN, content, _END))
        return await self._post("Transfer-Encoding: chunked", [*body, b"0\r\n\r\n"])

    async def announce(self, length: int) -> tuple[int, str]:
        """Send the head of an upload of `length` bytes without its body, and return status and text of the answer."""
        return await self._post(_length(length), [])

    async def _post(self, header: str, body: Iterable[bytes]) -> tuple[int, str]:
        status, answer = await self._console.request(f"POST {self._place}", _FORM, header, body=body)
        return status, answer.decode(errors="replace")


async def uploader(console: RunningConsole) -> Uploader:
    """Request a page as a browser does, and find its upload address.

    Raises:
        Unmet: The page has none within `PATIENCE`: the console does not reach the daemon.
    """
    with suppress(TimeoutError):
        async with asyncio.timeout(PATIENCE):
            while True:
                _, page = await console.request("GET /")
                if found := _PLACE.search(page):
                    return Uploader(console, found.group().decode())
                await asyncio.sleep(0.5)
    raise Unmet(f"The page showed no upload within {PATIENCE:g} s.")


def _length(length: int) -> str:
    return f"Content-Length: {length}"
