"""The real-time policy, whether this user may use it, and programs that use it, for tests."""

from __future__ import annotations

import os
import threading
from contextlib import suppress

import pytest

from pcmrs.threads import Priority

REALTIME = os.SCHED_RR | os.SCHED_RESET_ON_FORK
DEMOTED = os.SCHED_OTHER | os.SCHED_RESET_ON_FORK


def permitted() -> bool:
    found: list[bool] = []

    def attempt() -> None:
        with suppress(PermissionError):
            os.sched_setscheduler(0, REALTIME, os.sched_param(Priority.HEART))
            found.append(True)

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return bool(found)


needs_permission = pytest.mark.skipif(not permitted(), reason="SCHED_RR is not permitted to this user")

RUNS_AWAY = "import threading\nt = threading.Thread(target=input)\nt.start()\nwhile t.is_alive(): pass"
