"""Ctrl-C in a search on two workers: exit status, nothing left behind, and what was finished is not run again."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest

from pcmrs_lab.campaign.explore.exploring import SessionTask, run_sessions

PATIENCE = 120.0
SESSIONS = 40
FOLDERS = Path("/dev/shm" if Path("/dev/shm").is_dir() else "/tmp")


def command(finished: Path, sessions: int) -> list[str]:
    words = ["faults", "explore", "--sessions", str(sessions), "--workers", "2", "--finished", str(finished), "--json"]
    return [sys.executable, "-m", "pcmrs.cli", *words]


def lines(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_bytes().splitlines()] if path.exists() else []


def below(pid: int) -> set[int]:
    """Returns the processes that a process and its children have started, from any of their threads."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
    found, new = set[int](), {pid}
    while new:
        new = {child for child, parent in parents.items() if parent in new}
        found |= new
    return found


def folders() -> set[Path]:
    return set(FOLDERS.glob("pcmrs-explore-*"))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_search_after_ctrl_c_continues(tmp_path: Path) -> None:
    finished, before = tmp_path / "finished.jsonl", folders()
    search = subprocess.Popen(
        command(finished, SESSIONS), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
    )
    end = time.monotonic() + PATIENCE
    while len(lines(finished)) < 2:
        assert search.poll() is None
        assert time.monotonic() < end
        time.sleep(0.05)
    processes = below(search.pid)
    assert len(processes) >= 4
    os.killpg(search.pid, signal.SIGINT)
    _, errors = search.communicate(timeout=PATIENCE)
    assert search.returncode == 130, errors
    assert b"Traceback" not in errors
    kept = lines(finished)
    assert 2 <= len(kept) < SESSIONS
    while any(Path(f"/proc/{each}").exists() for each in processes) or folders() - before:
        assert time.monotonic() < end + PATIENCE
        time.sleep(0.05)
    more = len(kept) + 4
    done = subprocess.run(command(finished, more), capture_output=True, text=True, check=True)
    report = json.loads(done.stdout)
    assert lines(finished)[: len(kept)] == kept
    assert report["sessions"] == more
    tasks = [SessionTask("ratms", "kinematic", seed) for seed in range(1, 3)]
    rows = {each["task"]["seed"]: each["result"] for each in lines(finished)}  # type: ignore[index]
    for found in run_sessions(tasks):
        result = msgspec.json.encode(rows[found.seed])
        digest = msgspec.msgpack.decode(msgspec.json.decode(result, type=bytes))["digest"]
        assert digest == found.digest
