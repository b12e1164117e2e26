"""Priority of a simulated world: other programs do not slow it down, as they do not slow down a cabinet."""

from __future__ import annotations

import os
import threading
from contextlib import suppress

NICE = -10
"""Nice value, as of the units in ``deploy/systemd``; not a real-time policy: other programs still get their share."""


def raise_priority() -> None:
    """Give `NICE` to the calling thread, and to all that it starts, if that is permitted."""
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
