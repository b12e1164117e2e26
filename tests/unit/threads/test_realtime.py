"""The real-time policy: who gets it and who inherits it; and short pauses of Python itself."""

from __future__ import annotations

import os
import subprocess
import sys

from tests.unit.threads.realtime_children import REALTIME, needs_permission

GIVEN = """
import asyncio, os, subprocess, sys, threading
from concurrent.futures import ThreadPoolExecutor
from pcmrs.threads import Priority, RealTime

async def run():
    ended = threading.Event()
    sending = ThreadPoolExecutor(1, thread_name_prefix="pcmrs-bus")
    reading = ThreadPoolExecutor(1, thread_name_prefix="pcmrs-bus-read")
    working = ThreadPoolExecutor(1, thread_name_prefix="planning")
    for pool in (sending, reading, working):
        pool.submit(int).result()
    keeping = asyncio.create_task(RealTime(Priority.LOOP).keep(asyncio.sleep))
    await asyncio.sleep(0)
    own = "import os; print(os.sched_getscheduler(0))"
    child = subprocess.run([sys.executable, "-c", own], capture_output=True, check=True)
    threads = [thread.native_id for pool in (sending, reading, working) for thread in pool._threads]
    print(*map(os.sched_getscheduler, (0, *threads)), child.stdout.decode())
    keeping.cancel()

asyncio.run(run())
"""


@needs_permission
def test_loop_and_bus_have_the_policy_and_workers_do_not() -> None:
    """Nor do children, and threads that send long replies."""
    said = subprocess.run([sys.executable, "-c", GIVEN], capture_output=True, text=True, check=True)
    expected = [REALTIME, REALTIME, os.SCHED_OTHER, os.SCHED_OTHER, os.SCHED_OTHER]
    assert [int(word) for word in said.stdout.split()] == expected, "loop, bus, long replies, worker, child"


WITHOUT = """
import os, resource
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
if os.getuid() == 0:
    os.setuid(65534)
"""


def test_missing_permission_is_reported_and_the_process_works() -> None:
    code = """
import asyncio
from pcmrs.threads import Priority, RealTime
realtime = RealTime(Priority.LOOP)
async def run():
    keeping = asyncio.create_task(realtime.keep(asyncio.sleep))
    await asyncio.sleep(0)
    assert not keeping.done()
    keeping.cancel()
    try:
        realtime.give()
    except PermissionError:
        print("refused")
asyncio.run(run())
"""
    imports = "from pcmrs.threads import Priority, RealTime\nimport asyncio\n"
    command = [sys.executable, "-c", imports + WITHOUT + code]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "refused\n"


def test_full_collection_scans_few_of_the_loaded_objects() -> None:
    """In a process of its own: it changes the interpreter."""
    program = "import gc, scipy.optimize\nfrom pcmrs.threads import keep_pauses_short\nprint(len(gc.get_objects()))\n"
    program += "keep_pauses_short()\nprint(len(gc.get_objects()))"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    before, after = map(int, ended.stdout.split())
    assert after < before / 100
