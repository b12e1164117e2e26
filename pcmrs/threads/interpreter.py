"""What Python does by itself, at times that nobody has chosen: it must not keep an event loop waiting."""

from __future__ import annotations

import gc
import sys

SWITCH = 0.0005
"""A thread that holds the interpreter's lock gives it to one that waits after this, s; Python's own value is 0.005."""


def keep_pauses_short() -> None:
    """Let neither other threads of this process nor the garbage collector keep its event loop waiting for long.

    Call it once, when the process has started. The real-time policy does not help against either: a thread that waits
    for the lock does not run, whatever its priority is, and the collector runs in the thread that needs memory. A full
    collection of all that a daemon loads takes about 60 ms; what exists now is not looked at again.
    """
    sys.setswitchinterval(SWITCH)
    gc.collect()
    gc.freeze()
