"""The process that watches the real-time threads of a device node which no daemon has started.

The heart of a daemon watches the processes below the daemon, and a node on another machine is none of them. Without a
watcher, a thread of the node that runs away would take a processor from everything else on its machine. The watcher is
a process, since a thread of the node could wait for the interpreter lock of the very thread that runs away.

    python -m pcmrs.devices.thread_watcher < a pipe that ends with the node
"""

from __future__ import annotations

import json
import os
import select
import sys
from contextlib import suppress

from pcmrs.clock import SystemClock
from pcmrs.threads import Priority, RealTime, Runaways, watched_processes

PERIOD = 0.1
"""Time between two checks, s."""


def main() -> None:
    """Watch the process that has started this one until standard input ends; print what runs away as lines of JSON."""
    node, clock = os.getppid(), SystemClock()
    runaways = Runaways(lambda: watched_processes(node))
    with suppress(PermissionError):
        RealTime(Priority.HEART).give()
    while not select.select([sys.stdin.fileno()], [], [], PERIOD)[0]:
        for each in runaways.check(clock.monotonic()):
            sys.stdout.write(f"{json.dumps(each)}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
