"""Transport that delays and reorders frames of a running daemon and its nodes, and counts them.

`Delays.install` returns the environment that loads `delayed_process` into a daemon and all its child processes. The
rules are a file that every process checks before each frame, so that they can change while the daemon runs.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Literal

import msgspec

from pcmrs.clock import SystemClock
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.sham import is_sham

VARIABLE = "PCMRS_DELAYS"
PATIENCE = 20.0
PERIOD = 0.02
FOLDER = "delays"
"""Name of the folder of rules below the folder of a cell."""

Place = Literal["send", "receive", "answer", "publish", "pass"]
"""Point at which a frame is delayed: the thread that sends a request, the delivery of the request, the thread that
replies to it, the delivery of a published message, or the code that passes a failpoint (disk thread, event loop)."""


class Rule(msgspec.Struct, frozen=True):
    """Rule that delays certain frames.

    Attributes:
        place: Point at which they are delayed.
        key: End of the frame's key, such as ``dev/robot/cmd``, or the name of a failpoint.
        word: Bytes that the payload must contain, such as the name of a method; empty for every payload.
        seconds: Delay, s.
        times: Number of frames per process that are delayed.
        id: Unique id, so that two equal rules stay different.
    """

    place: Place
    key: str
    word: str = ""
    seconds: float = 0.0
    times: int = 1
    id: str = msgspec.field(default_factory=lambda: uuid.uuid4().hex)


class Delayed(msgspec.Struct, frozen=True):
    """Record of a delayed frame.

    Attributes:
        rule: Rule that delayed it.
        begun: Time at which it arrived, s of the machine.
        ended: Time at which it continued, s of the machine.
        overtaken: Number of frames of the same place and key that passed in the meantime.
    """

    rule: Rule
    begun: float
    ended: float
    overtaken: int


class Delays:
    """Rules of one cell's transport.

    Args:
        folder: Folder for the rules.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def install(self) -> Mapping[str, str]:
        """Create the folder without rules, and return the environment of a delayed process and its children."""
        self._folder.mkdir(parents=True, exist_ok=True)
        program = "import pcmrs_lab.campaign.delayed_process as p\n\np.install()\n"
        (self._folder / "sitecustomize.py").write_text(program)
        self._write([])
        path = os.pathsep.join(filter(None, (str(self._folder), os.environ.get("PYTHONPATH"))))
        return {VARIABLE: str(self._folder), "PYTHONPATH": path}

    @asynccontextmanager
    async def delaying(self, *rules: Rule, ended: bool = True) -> AsyncIterator[None]:
        """Apply rules for the length of the context, in addition to those of contexts around it.

        Args:
            rules: Rules to apply.
            ended: True if each rule must have delayed a frame to its end; False if the process may end before.

        Raises:
            Unmet: A rule has delayed nothing by the end of the context and `PATIENCE`.
        """
        self._write([*self._rules(), *rules])
        try:
            yield
            for rule in rules:
                await (self.wait_until_delayed(rule) if ended else self.wait_until_delaying(rule))
        finally:
            self._write([rule for rule in self._rules() if rule not in rules])

    async def wait_until_delayed(self, rule: Rule, count: int = 1) -> list[Delayed]:
        """Wait until a rule has delayed a number of frames to their end, and return their records.

        Args:
            rule: Rule that must take effect.
            count: Number of frames.

        Raises:
            Unmet: It has not within `PATIENCE`.
        """
        clock = SystemClock()
        started = clock.monotonic()
        while len(found := [each for each in self._records() if each.rule == rule]) < count:
            if clock.monotonic() - started > PATIENCE:
                raise Unmet(f"The fault was not injected: {rule} delayed {len(found)} of {count} frames.")
            await clock.sleep(PERIOD)
        return found

    async def wait_until_delaying(self, rule: Rule) -> None:
        """Wait until a rule is delaying a frame.

        Raises:
            Unmet: No frame is delayed within `PATIENCE`.
        """
        clock = SystemClock()
        started = clock.monotonic()
        while rule not in self._started():
            if clock.monotonic() - started > PATIENCE:
                raise Unmet(f"The fault was not injected: {rule} delayed no frame.")
            await clock.sleep(PERIOD / 4)

    def _rules(self) -> list[Rule]:
        return msgspec.json.decode((self._folder / "rules").read_bytes(), type=list[Rule])

    def _write(self, rules: list[Rule]) -> None:
        scratch = self._folder / "rules.new"
        scratch.write_bytes(msgspec.json.encode([] if is_sham() else rules))
        scratch.replace(self._folder / "rules")  # replaced atomically, so that no process reads half a file

    def _started(self) -> list[Rule]:
        return [msgspec.json.decode(line, type=Rule) for line in self._lines("begun")]

    def _records(self) -> list[Delayed]:
        return [msgspec.json.decode(line, type=Delayed) for line in self._lines("done")]

    def _lines(self, name: str) -> list[bytes]:
        file = self._folder / name
        return file.read_bytes().splitlines() if file.exists() else []


def delays_of(cell: RunningCell) -> Delays:
    """Return the rules of a cell that was started as ``delayed``."""
    return Delays(cell.folder / FOLDER)
