"""File descriptors of the process: more of them than all connections together may need."""

from __future__ import annotations

import resource
from typing import Final

NEEDED: Final = 4096
"""Number of descriptors.

The links accept 40 connections, the metrics 8, the bus 1,000 sessions and 100 more that have sent nothing yet. The
rest is for the daemon itself. None is reserved for Stop, whose datagrams and open connections need no new one.
"""


def reserve() -> None:
    """Raise the limit of this process to `NEEDED`, or as far as permitted; child processes inherit it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = NEEDED if hard == resource.RLIM_INFINITY else min(NEEDED, hard)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
