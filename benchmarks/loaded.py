"""Demo and operator errors on a busy machine: how many runs pass, and why the others end.

Every run starts a separate daemon. A run passes if its exit status is 0; otherwise its last line, which names the
reason, is shown. A run that ends in a traceback or by its time limit counts as `broken`. The lateness of a bare timer
of 100 ms in an idle process is measured at the same time.

    .venv/bin/python benchmarks/loaded.py [demo failures] [--runs 20] [--hogs 8] [--without-permission] [--json]

`--keep F` copies the cell's folder and the output of each run that does not pass to a folder in F.

`--without-permission` removes RLIMIT_RTPRIO and, for root, CAP_SYS_NICE from the runs, so that none of their threads
has the real-time policy."""

from __future__ import annotations

import argparse
import ctypes
import json
import multiprocessing
import os
import platform
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

COMMANDS = {"demo": ("demo",), "failures": ("experiment", "failures")}
LONGEST = 1200.0
PERIOD = 0.1
PR_CAPBSET_DROP, CAP_SYS_NICE = 24, 23  # prctl(2), capabilities(7)
Report = dict[str, dict[str, object]]


def hog() -> None:
    """Compute in a separate session: Linux may give all processes of a session one share of the processors."""
    os.setsid()
    while True:
        sum(range(100_000))


def note_timer(found: multiprocessing.SimpleQueue[float]) -> None:
    """Report the lateness of a bare timer, s, until killed."""
    while True:
        started = time.monotonic()
        time.sleep(PERIOD)
        found.put(time.monotonic() - started - PERIOD)


@contextmanager
def beside(hogs: int) -> Iterator[multiprocessing.SimpleQueue[float]]:
    """Run busy processes, and one with a timer, for the length of the context."""
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
    """Drop the permission of the real-time policy; of root, the capability is dropped from later executables."""
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    if os.getuid() == 0 and ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE, 0, 0, 0) != 0:
        raise OSError("CAP_SYS_NICE cannot be dropped")


def run_once(words: tuple[str, ...], prepare: Callable[[], None] | None, keep: Path | None) -> tuple[str, str, float]:
    """Return how one run ended (passed, held, broken), its last line, and its duration, s.

    Args:
        words: Words of the command.
        prepare: Called in the child process before the command; None for nothing.
        keep: Folder for what a run that does not pass leaves; None to delete it.
    """
    started = time.monotonic()
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
        if keep is not None and ended.returncode != 0:
            kept = keep / f"{'-'.join(words)}-{time.strftime('%Y%m%dT%H%M%S')}"
            shutil.copytree(folder, kept, ignore_dangling_symlinks=True)
            (kept / "output").write_text(ended.stdout + ended.stderr)
    lines = [line for line in (ended.stdout + ended.stderr).splitlines() if line.strip()]
    if ended.returncode == 0:
        return "passed", "", time.monotonic() - started
    kind = "broken" if "Traceback" in ended.stderr else "held"
    return kind, lines[-1] if lines else f"exit status {ended.returncode}", time.monotonic() - started


def measure(
    what: list[str], runs: int, hogs: int, prepare: Callable[[], None] | None, keep: Path | None = None
) -> Report:
    """Return the results of some commands.

    Args:
        what: Keys of `COMMANDS`.
        runs: Number of runs of each.
        hogs: Number of busy processes.
        prepare: Called in the child process before the command; None for nothing.
        keep: See `run_once`.
    """
    found: Report = {}
    for name in what:
        with beside(hogs) as late:
            ends = []
            for number in range(runs):
                ends.append(run_once(COMMANDS[name], prepare, keep))
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
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", choices=[*COMMANDS, []], help="commands; all by default")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--hogs", type=int, default=8)
    parser.add_argument("--processors", type=int, default=2, help="number of processors that all processes share")
    parser.add_argument("--without-permission", action="store_true")
    parser.add_argument("--keep", type=Path, metavar="F", help="folder for what failed runs leave")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: options.processors])
    prepare = without_permission if options.without_permission else None
    found = measure(options.what or list(COMMANDS), options.runs, options.hogs, prepare, options.keep)
    if options.json:
        print(json.dumps(found))
        return
    print(f"{platform.platform()}, Python {platform.python_version()}, {options.hogs} processes that compute")
    for name, values in found.items():
        print(name, *(f"  {key}: {value}" for key, value in values.items()), sep="\n")


if __name__ == "__main__":
    main()
