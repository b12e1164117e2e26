"""The demo and the paper's operator errors beside programs that compute: how many runs pass, and why the others end.

Every run starts a daemon of its own. It passes when its exit status is 0; of one that does not, the last line is shown,
which names the reason. One that ends in a traceback or by its time limit counts as `broken`. Beside them, how late a
bare timer of 100 ms is in a process that does nothing else.

    .venv/bin/python benchmarks/loaded.py [demo failures] [--runs 20] [--hogs 8] [--without-permission] [--json]

`--without-permission` takes RLIMIT_RTPRIO and, from root, CAP_SYS_NICE away from the runs, so that no thread of theirs
has the real-time policy.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import multiprocessing
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

COMMANDS = {"demo": ("demo",), "failures": ("experiment", "failures")}
LONGEST = 1200.0
PERIOD = 0.1
PR_CAPBSET_DROP, CAP_SYS_NICE = 24, 23  # prctl(2), capabilities(7)
Report = dict[str, dict[str, object]]


def hog() -> None:
    """Compute in a session of its own: Linux may give all processes of a session one share of the processors."""
    os.setsid()
    while True:
        sum(range(100_000))


def note_timer(found: multiprocessing.SimpleQueue[float]) -> None:
    while True:
        begun = time.monotonic()
        time.sleep(PERIOD)
        found.put(time.monotonic() - begun - PERIOD)


@contextmanager
def beside(hogs: int) -> Iterator[multiprocessing.SimpleQueue[float]]:
    """Processes that compute, and one with a timer."""
    late: multiprocessing.SimpleQueue[float] = multiprocessing.SimpleQueue()
    processes = [multiprocessing.Process(target=hog, daemon=True) for _ in range(hogs)]
    processes.append(multiprocessing.Process(target=note_timer, args=(late,), daemon=True))
    for process in processes:
        process.start()
    try:
        yield late
    finally:
        for process in processes:
            process.kill()
            process.join()


def without_permission() -> None:
    """Of root, the capability is taken from whatever is executed from now on."""
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    if os.getuid() == 0 and ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE, 0, 0, 0) != 0:
        raise OSError("CAP_SYS_NICE cannot be dropped")


def run_once(words: tuple[str, ...], prepare: Callable[[], None] | None) -> tuple[str, str, float]:
    """How it ended (passed, held, broken), its last line, and how long it took, s."""
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "HOME": folder, "XDG_STATE_HOME": folder, "TMPDIR": folder}
        command = [sys.executable, "-m", "pcmrs.cli", *words]
        try:
            ended = subprocess.run(
                command,
                capture_output=True,
                text=True,
                env=environment,
                preexec_fn=prepare,
                timeout=LONGEST,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return "broken", f"not ended after {LONGEST:g} s", LONGEST
    lines = [line for line in (ended.stdout + ended.stderr).splitlines() if line.strip()]
    if ended.returncode == 0:
        return "passed", "", time.monotonic() - begun
    kind = "broken" if "Traceback" in ended.stderr else "held"
    return kind, lines[-1] if lines else f"exit status {ended.returncode}", time.monotonic() - begun


def measure(what: list[str], runs: int, hogs: int, prepare: Callable[[], None] | None) -> Report:
    found: Report = {}
    for name in what:
        with beside(hogs) as late:
            ends = []
            for number in range(runs):
                ends.append(run_once(COMMANDS[name], prepare))
                print(f"{name} {number + 1} of {runs}: {ends[-1]}", file=sys.stderr, flush=True)
            timer = []
            while not late.empty():
                timer.append(late.get() * 1e3)
        found[name] = {
            "runs": runs,
            **{kind: sum(end == kind for end, _, _ in ends) for kind in ("passed", "held", "broken")},
            "reasons": [text for _, text, _ in ends if text],
            "seconds, median": round(float(np.median([seconds for _, _, seconds in ends])), 1),
            "timer late, ms, p50 p99 max": [round(float(each), 1) for each in np.percentile(timer, (50, 99, 100))],
        }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", choices=[*COMMANDS, []], help="which of them; all by default")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--hogs", type=int, default=8)
    parser.add_argument("--processors", type=int, default=2, help="that all of them share")
    parser.add_argument("--without-permission", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: options.processors])
    prepare = without_permission if options.without_permission else None
    found = measure(options.what or list(COMMANDS), options.runs, options.hogs, prepare)
    if options.json:
        print(json.dumps(found))
        return
    print(f"{platform.platform()}, Python {platform.python_version()}, {options.hogs} processes that compute")
    for name, values in found.items():
        print(name, *(f"  {key}: {value}" for key, value in values.items()), sep="\n")


if __name__ == "__main__":
    main()
