"""The recording of a journal's writer has all its system calls, or the row is not run."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from pcmrs.testing.needs import Need
from pcmrs_lab.campaign import syscall_trace
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.syscall_trace import trace_journal


@pytest.fixture
def strace(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Command lines of a tracer that records one call."""
    ran: list[list[str]] = []

    def run(words: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        ran.append(words)
        Path(words[words.index("-o") + 1]).write_text("1  openat(...) = 3\n1  write(...) = 1\n")
        return subprocess.CompletedProcess(words, 0, "", "")

    monkeypatch.setattr(syscall_trace, "NEEDS", ())
    monkeypatch.setattr(subprocess, "run", run)
    return ran


@pytest.mark.parametrize(("durable", "word"), [(True, "durable"), (False, "careless")])
def test_the_calls_of_a_writer_are_recorded(strace: list[list[str]], tmp_path: Path, durable: bool, word: str) -> None:
    calls = trace_journal(tmp_path / "written", 40, 7, durable=durable)
    assert calls == ["1  openat(...) = 3", "1  write(...) = 1"]
    (words,) = strace
    assert words[-4:] == [str(tmp_path / "written"), "40", "7", word]
    assert {"-f", "-y", "-xx"} <= set(words), "replaying needs all threads, paths and bytes"
    assert (tmp_path / "written").is_dir()


def test_a_machine_that_cannot_trace_does_not_run_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(words: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess(words, 1, "", "strace: not permitted\n")

    monkeypatch.setattr(syscall_trace, "NEEDS", ())
    monkeypatch.setattr(subprocess, "run", run)
    with pytest.raises(NotRun, match="cannot record here: strace: not permitted"):
        trace_journal(tmp_path / "written", 40, 7)
    monkeypatch.setattr(syscall_trace, "NEEDS", (Need("strace", lambda: False),))
    with pytest.raises(NotRun, match="strace"):
        trace_journal(tmp_path / "other", 40, 7)
    assert not (tmp_path / "other").exists()
