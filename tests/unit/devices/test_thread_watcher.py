"""A device node that no daemon has started has its own watcher of real-time threads."""

from __future__ import annotations

import json
import subprocess
import sys

from tests.unit.threads.realtime_children import DEMOTED, needs_permission

NODE = """
import asyncio, json, os, threading
from pcmrs.node import watch_threads
from pcmrs.threads import Priority, Runaway

found = []

def run_away():
    os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(Priority.DEVICE))
    while not found:
        pass

async def serve():
    reported = asyncio.Event()

    def report(runaway: Runaway):
        policy = os.sched_getscheduler(thread.native_id)
        found.append([runaway.thread == thread.native_id, runaway.process == os.getpid(), runaway.refused, policy])
        reported.set()

    thread = threading.Thread(target=run_away)
    thread.start()
    watching = asyncio.create_task(watch_threads(report))
    await reported.wait()
    watching.cancel()
    await asyncio.gather(watching, return_exceptions=True)
    thread.join()
    print(json.dumps(found))

asyncio.run(serve())
"""


@needs_permission
def test_a_thread_of_a_node_that_runs_away_is_demoted() -> None:
    ended = subprocess.run([sys.executable, "-c", NODE], capture_output=True, text=True, check=True, timeout=60.0)
    assert json.loads(ended.stdout) == [[True, True, "", DEMOTED]]
