"""Descriptors of the process: enough of them that Stop finds one, whatever others hold."""

from __future__ import annotations

import resource
from typing import Final

NEEDED: Final = 4096
"""The links take 40 connections, the bus 1,000 sessions and 100 more that say nothing yet; the rest is reserved."""


def reserve() -> None:
    """Raises the limit of this process to `NEEDED`, as far as it may; child processes inherit it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = NEEDED if hard == resource.RLIM_INFINITY else min(NEEDED, hard)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
