"""The process of a simulated world. Standard input is the link to its node; the process ends with the link.

`pcmrs_sim.process.starting` starts it as ``python -m pcmrs_sim.process.world``, or by a fork.
"""

from __future__ import annotations

import os
import signal
import socket
import sys

from pcmrs.cli.log import log_to_stderr
from pcmrs.cli.running import run
from pcmrs_sim.process.priority import raise_priority

# MuJoCo looks for a window system, in two more processes, unless this is set before it is imported.
os.environ.setdefault("MUJOCO_GL", "disable")

from pcmrs_sim.process.server import Server


async def _serve() -> None:
    await Server(socket.socket(fileno=sys.stdin.fileno())).run()


def main() -> None:
    """Serve the node until it ends."""
    for number in (signal.SIGINT, signal.SIGTERM):
        # Its node holds the arm before it ends, and then closes the link, which ends this process.
        signal.signal(number, signal.SIG_IGN)
    raise_priority()
    log_to_stderr()
    run(_serve())


if __name__ == "__main__":
    main()
