"""Threads that run away lose the real-time policy, and calm ones get it back."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import time

import pytest

from pcmrs.threads import Runaways, Threads, _runaways
from pcmrs.threads._runaways import CALM
from tests.unit.threads.realtime_children import DEMOTED, REALTIME, RUNS_AWAY, needs_permission

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
        assert os.sched_getscheduler(runaway.pid) == DEMOTED
        assert os.sched_getscheduler(resting.pid) == REALTIME
        now = time.monotonic()
        assert watch.check(now) == []
        assert watch.check(now + 0.01) == []
        assert os.sched_getscheduler(runaway.pid) == DEMOTED, "it still does not rest"
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
            assert os.sched_getscheduler(child.pid) == DEMOTED
            assert watch.check(now + passed) == []
        assert os.sched_getscheduler(child.pid) == REALTIME
        assert os.sched_getparam(child.pid).sched_priority == 10
        child.kill()


def test_threads_of_processes_without_policy_are_rarely_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    listed: list[int] = []

    class Listed(Threads):
        def ids(self) -> list[int]:
            listed.append(0)
            return super().ids()

    monkeypatch.setattr(_runaways, "Threads", Listed)
    watch = Runaways(lambda: [os.getpid()])
    for tenth in range(21):
        assert watch.check(0.1 * tenth) == []
    assert len(listed) == 3


@needs_permission
def test_runaway_beside_a_main_thread_without_policy_is_found() -> None:
    code = f"import os, threading\ndef away():\n  os.sched_setscheduler(0, {REALTIME}, os.sched_param(10))\n"
    code += "  while True: pass\n"
    code += "threading.Thread(target=away, daemon=True).start()\nprint('here', flush=True)\ninput()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=-1, stdout=-1) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"here\n"
        watch = Runaways(lambda: [child.pid])
        while not (found := watch.check(time.monotonic())):
            time.sleep(0.02)
        assert found[0].process == child.pid
        assert found[0].thread != child.pid
        child.kill()


IMPORTS = "import json, os, time\nfrom pcmrs.threads import Priority, Runaways\n"
BECOME_NOBODY = """
if os.getuid() == 0:
    os.setgroups([])
    os.setresgid(65534, 65534, 65534)
    os.setresuid(65534, 65534, 65534)
"""
BEGIN_RUNAWAY = """
watcher = os.getpid()
runaway = os.fork()
if runaway == 0:
    os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(Priority.LOOP))
    exec(OF_THE_RUNAWAY)
    while os.getppid() == watcher:
        pass
    os._exit(0)
"""
WATCH = """
watch, found = Runaways(lambda: [runaway]), []
while not found:
    time.sleep(0.02)
    found = watch.check(time.monotonic())
later = [watch.check(time.monotonic()) for _ in range(3)]
print(json.dumps([os.sched_getscheduler(runaway), [each.refused for each in found], later]))
"""


def seen_by_nobody(of_the_runaway: str) -> list[object]:
    """Policy of the runaway thread in the end, why it could not be demoted, and what later checks find."""
    of_the_runaway = f"OF_THE_RUNAWAY = {of_the_runaway!r}\n"
    command = [sys.executable, "-c", IMPORTS + of_the_runaway + BEGIN_RUNAWAY + BECOME_NOBODY + WATCH]
    ended = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60.0)
    seen: list[object] = json.loads(ended.stdout)
    return seen


@needs_permission
def test_a_user_without_capabilities_can_demote_a_thread() -> None:
    """As under the units and in the container, where no process has CAP_SYS_NICE."""
    assert seen_by_nobody(BECOME_NOBODY) == [DEMOTED, [""], [[], [], []]]


@needs_permission
@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_a_thread_that_cannot_be_demoted_is_reported_once() -> None:
    """Never as demoted: it belongs to another user."""
    assert seen_by_nobody("") == [REALTIME, [os.strerror(errno.EPERM)], [[], [], []]]
