"""The process of a simulated world: standard input is the link to its node, with which it ends.

python -m pcmrs_sim.process < link
"""

from __future__ import annotations

import signal
import socket
import sys

from pcmrs.cli.log import log_to_stderr
from pcmrs.cli.running import run
from pcmrs_sim.process.server import Server


async def _serve() -> None:
    await Server(socket.socket(fileno=sys.stdin.fileno())).run()


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # its node holds the arm before it ends, and then ends the link
    log_to_stderr()
    run(_serve())
