"""The wall clock of a process is set, moves on and stands, and its monotonic clock is the machine's."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pcmrs_lab.campaign.walltime import NEEDS, WallClock

PROGRAM = """
import time
for _ in range(4):
    input()
    print(time.time(), time.time_ns(), time.clock_gettime(time.CLOCK_REALTIME), time.monotonic(), flush=True)
    time.sleep(0.001)
"""
NEAR = 60.0
"""Within this two clocks show the same, s."""


@pytest.mark.skipif(not all(need.is_met() for need in NEEDS), reason="no C compiler")
def test_only_the_wall_clock_is_set(tmp_path: Path) -> None:
    clock = WallClock.create(tmp_path / "clock")
    environment = {**os.environ, **clock.environment()}
    command = [sys.executable, "-c", PROGRAM]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment) as process:
        asking, answers = process.stdin, process.stdout
        assert asking is not None
        assert answers is not None

        def told() -> list[float]:
            print(file=asking, flush=True)
            wall, wall_ns, realtime, monotonic = map(float, answers.readline().split())
            assert wall == pytest.approx(realtime, abs=1.0)
            assert wall == pytest.approx(wall_ns / 1e9, abs=1.0)
            assert monotonic == pytest.approx(time.monotonic(), abs=NEAR)
            return [wall, time.time()]

        wall, now = told()
        assert wall == pytest.approx(now, abs=NEAR)
        clock.shift(-3600.0)
        wall, now = told()
        assert wall == pytest.approx(now - 3600.0, abs=NEAR)
        clock.freeze()
        first, _ = told()
        second, now = told()
        assert first == second == pytest.approx(now, abs=NEAR)
