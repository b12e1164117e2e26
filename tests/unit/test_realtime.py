"""The real-time policy: who gets it, who inherits it, and from whom it is taken."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from contextlib import suppress

import pytest

from pcmrs.threads import Priority, Runaways
from pcmrs.threads.runaways import CALM

REALTIME = os.SCHED_RR | os.SCHED_RESET_ON_FORK


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

GIVEN = """
import asyncio, os, subprocess, sys, threading
from concurrent.futures import ThreadPoolExecutor
from pcmrs.threads import Priority, RealTime

async def run():
    ended = threading.Event()
    sending = ThreadPoolExecutor(1, thread_name_prefix="pcmrs-bus")
    working = ThreadPoolExecutor(1, thread_name_prefix="planning")
    for pool in (sending, working):
        pool.submit(int).result()
    keeping = asyncio.create_task(RealTime(Priority.LOOP).keep(asyncio.sleep))
    await asyncio.sleep(0)
    own = "import os; print(os.sched_getscheduler(0))"
    child = subprocess.run([sys.executable, "-c", own], capture_output=True, check=True)
    threads = [thread.native_id for pool in (sending, working) for thread in pool._threads]
    print(*map(os.sched_getscheduler, (0, *threads)), child.stdout.decode())
    keeping.cancel()

asyncio.run(run())
"""


@needs_permission
def test_loop_and_bus_have_the_policy_and_workers_do_not() -> None:
    """Nor do children."""
    said = subprocess.run([sys.executable, "-c", GIVEN], capture_output=True, text=True, check=True)
    expected = [REALTIME, REALTIME, os.SCHED_OTHER, os.SCHED_OTHER]
    assert [int(word) for word in said.stdout.split()] == expected, "loop, bus, worker, child"


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


RUNS_AWAY = "import threading\nt = threading.Thread(target=input)\nt.start()\nwhile t.is_alive(): pass"
RESTS = "input()"


@needs_permission
def test_runaway_thread_loses_the_policy_and_a_resting_keeps_it() -> None:
    begin = f"import os; os.sched_setscheduler(0, {REALTIME}, os.sched_param(10))\nprint('here', flush=True)\n"
    with (
        subprocess.Popen([sys.executable, "-c", begin + RUNS_AWAY], stdin=-1, stdout=-1) as runaway,
        subprocess.Popen([sys.executable, "-c", begin + RESTS], stdin=-1, stdout=-1) as resting,
    ):
        pair = (runaway, resting)
        for child in pair:
            assert child.stdout is not None
            assert child.stdout.readline() == b"here\n"
        watch = Runaways(lambda: [child.pid for child in pair])
        while not (found := watch.check(time.monotonic())):
            assert os.sched_getscheduler(runaway.pid) == REALTIME
            time.sleep(0.02)
        assert [(each.process, each.thread) for each in found] == [(runaway.pid, runaway.pid)]
        assert os.sched_getscheduler(runaway.pid) == os.SCHED_OTHER
        assert os.sched_getscheduler(resting.pid) == REALTIME
        now = time.monotonic()
        assert watch.check(now) == []
        assert watch.check(now + 0.01) == []
        assert os.sched_getscheduler(runaway.pid) == os.SCHED_OTHER, "it still does not rest"
        for child in pair:
            child.communicate(b"\n")


@needs_permission
def test_a_thread_that_rests_again_gets_the_policy_back() -> None:
    code = f"import os; os.sched_setscheduler(0, {REALTIME}, os.sched_param(10))\nprint('here', flush=True)\n"
    code += f"{RUNS_AWAY}\nprint('rests', flush=True)\nimport time\ntime.sleep(100)"
    with subprocess.Popen([sys.executable, "-c", code], stdin=-1, stdout=-1) as child:
        assert child.stdout is not None
        assert child.stdin is not None
        assert child.stdout.readline() == b"here\n"
        watch = Runaways(lambda: [child.pid])
        while not watch.check(time.monotonic()):
            time.sleep(0.02)
        child.stdin.write(b"\n")
        child.stdin.flush()
        assert child.stdout.readline() == b"rests\n"
        now = time.monotonic()
        for passed in (0.0, 0.9 * CALM, 1.1 * CALM):
            assert os.sched_getscheduler(child.pid) == os.SCHED_OTHER
            assert watch.check(now + passed) == []
        assert os.sched_getscheduler(child.pid) == REALTIME
        assert os.sched_getparam(child.pid).sched_priority == 10
        child.kill()
