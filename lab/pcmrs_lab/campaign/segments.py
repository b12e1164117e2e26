"""TCP segments that a connection has received, as the kernel counts them at the receiver's socket."""

from __future__ import annotations

import asyncio
import re
from dataclasses import dataclass

from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.needs import program

SS = program("ss")
"""The tool that asks the kernel; it needs no rights."""

COUNTS = ("data_segs_in", "data_segs_out")


@dataclass(frozen=True, slots=True)
class Segments:
    """Segments with data of one connection, from its client's side.

    Attributes:
        received: From the server.
        sent: To it.
    """

    received: int
    sent: int

    def since(self, before: Segments) -> Segments:
        """What came after `before`."""
        return Segments(self.received - before.received, self.sent - before.sent)

    @property
    def per_request(self) -> float:
        """Segments received for one that was sent."""
        return self.received / self.sent if self.sent else 0.0


async def segments(port: int) -> Segments:
    """Of the one connection that this machine has to a port.

    Raises:
        Unmet: There is none, or several.
    """
    words = ("ss", "-tinH", "state", "established", f"( dport = :{port} )")
    process = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE)
    shown, _ = await process.communicate()
    found = [[int(each) for each in re.findall(rf"\b{name}:(\d+)", shown.decode())] for name in COUNTS]
    if [len(each) for each in found] != [1, 1]:
        raise Unmet(f"The kernel does not show one connection to port {port}: {shown.decode()}")
    return Segments(found[0][0], found[1][0])
