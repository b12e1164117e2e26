"""The process that reads an uploaded file can do nothing else."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

CONFINED = """
import os, resource, socket, subprocess, sys, threading
from pcmrs.console.planning._confined import confine

go, out = threading.Event(), []
def beside():
    go.wait()
    out.append(refused(socket.socket))
def refused(act, *words):
    try:
        act(*words)
    except (OSError, MemoryError) as error:
        return type(error).__name__
    return "done"
thread = threading.Thread(target=beside, daemon=True)
thread.start()
file = os.open(sys.argv[2], os.O_WRONLY | os.O_CREAT)
if sys.argv[1] == "confined":
    confine(2**30, 60)
out += [refused(socket.socket), refused(subprocess.run, ["/bin/true"])]
out += [refused(bytes, 2**31), refused(os.write, file, b"x")]
go.set()
thread.join()
print(*out)
"""


@pytest.mark.parametrize("how", ["free", "confined"])
def test_reader_has_no_network_no_programs_and_little_memory(how: str, tmp_path: Path) -> None:
    words = [sys.executable, "-c", CONFINED, how, str(tmp_path / "file")]
    said = subprocess.run(words, capture_output=True, text=True, check=True, timeout=120).stdout.split()
    ended = ["PermissionError", "PermissionError", "MemoryError", "OSError", "PermissionError"]
    assert said == (ended if how == "confined" else ["done"] * 5)
