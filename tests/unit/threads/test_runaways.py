"""Threads that run away lose the real-time policy, and calm ones get it back."""

from __future__ import annotations

import os
import subprocess
import sys
import time

from pcmrs.threads import Runaways
from pcmrs.threads._runaways import CALM
from tests.unit.threads.realtime_children import REALTIME, RUNS_AWAY, needs_permission

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
