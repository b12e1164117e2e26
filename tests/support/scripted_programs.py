"""Programs that are only written down, in place of real ones."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from typing import Any

import pytest


class Programs:
    """Programs that are run and started.

    Attributes:
        words: Command lines, and ends of processes, in order.
        inputs: Their standard inputs.
        fails: Called with the words of a command; true if it fails.
        stubborn: A process does not end when it is asked to.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.words: list[str] = []
        self.inputs: list[str] = []
        self.fails: Callable[[str], bool] = lambda _: False
        self.stubborn = False
        monkeypatch.setattr(subprocess, "run", self._run)
        monkeypatch.setattr(subprocess, "Popen", self._start)

    def _run(self, words: Sequence[str], input: str = "", **_: Any) -> subprocess.CompletedProcess[str]:
        line = " ".join(words)
        self.words.append(line)
        self.inputs.append(input)
        if self.fails(line):
            raise subprocess.CalledProcessError(1, list(words))
        return subprocess.CompletedProcess(list(words), 0, "", "")

    def _start(self, words: Sequence[str], **_: Any) -> Any:
        self.words.append(" ".join(words))
        return Process(self)

    @property
    def added(self) -> list[str]:
        return [line.split()[-1] for line in self.words if "netns add" in line]

    @property
    def deleted(self) -> list[str]:
        return [line.split()[-1] for line in self.words if "netns delete" in line]


class Process:
    def __init__(self, programs: Programs) -> None:
        self._programs = programs

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        self._programs.words.append("closed")

    def terminate(self) -> None:
        self._programs.words.append("terminated")

    def wait(self, timeout: float) -> int:
        if self._programs.stubborn:
            raise subprocess.TimeoutExpired("it", timeout)
        return 0

    def kill(self) -> None:
        self._programs.words.append("killed")
