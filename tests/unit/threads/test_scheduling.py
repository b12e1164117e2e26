"""What Linux says of the threads and children of a process."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from pcmrs.threads import Load, Threads, _scheduling, descendants

WORK = "n = 0\nwhile n < 2_000_000: n += 1\nprint('done', flush=True)\ninput()"

UNTIL_TOLD = "import threading\nt = threading.Thread(target=input)\nt.start()\nwhile t.is_alive(): pass"


def test_working_thread_is_pending_and_a_sleeping_one_is_not() -> None:
    resting = threading.Event()
    thread = threading.Thread(target=resting.wait)
    thread.start()
    threads = Threads()
    assert thread.native_id in threads.times()
    assert threading.get_native_id() in threads.names()
    assert list(threads.times(lambda thread: thread == os.getpid())) == [os.getpid()]
    with subprocess.Popen([sys.executable, "-c", UNTIL_TOLD], stdin=subprocess.PIPE) as child:
        other = Threads(child.pid)
        while not other.pending() or other.times()[child.pid].ran == 0.0:
            assert child.poll() is None
        child.communicate(b"\n")
    assert other.times() == {}, "it has ended"
    assert other.ids() == []
    resting.set()
    thread.join()


def test_processes_sharing_a_processor_wait_and_add_to_the_load() -> None:
    """Both want the same processor: whoever is measured has waited when it has done its work."""
    (processor, *_) = os.sched_getaffinity(0)
    pinned = f"import os; os.sched_setaffinity(0, [{processor}]); print('here', flush=True); input()\n{WORK}"
    with (
        subprocess.Popen([sys.executable, "-c", pinned], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as one,
        subprocess.Popen([sys.executable, "-c", pinned], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as two,
    ):
        pair = (one, two)
        for child in pair:
            assert child.stdout is not None
            assert child.stdout.readline() == b"here\n"
        measured = [Threads(child.pid) for child in pair]
        assert [threads.waited() for threads in measured] == [0.0, 0.0], "it counts from the first call"
        for child in pair:
            assert child.stdin is not None
            child.stdin.write(b"\n")
            child.stdin.flush()
        for child in pair:
            assert child.stdout is not None
            assert child.stdout.readline() == b"done\n"
        assert max(threads.waited() for threads in measured) > 0.001
        assert Threads().load().processors == len(os.sched_getaffinity(0))
        for child in pair:
            child.communicate(b"\n")


def test_children_are_those_that_run_and_none_of_ended_process() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        assert child.pid in descendants(os.getpid())
        child.communicate(b"\n")
    assert child.pid not in descendants(os.getpid())
    assert descendants(child.pid) == []


def test_load_is_not_known_where_the_machine_hides_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As systemd does with ProcSubset=pid."""
    assert Threads().load().running is not None
    monkeypatch.setattr(_scheduling, "LOAD_FILE", str(tmp_path / "loadavg"))
    load = Threads().load()
    assert load == Load(None, len(os.sched_getaffinity(0)))
    assert not load.is_too_high
    assert str(load) == "the load of the machine is not known"
