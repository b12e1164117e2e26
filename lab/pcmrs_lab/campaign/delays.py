"""A transport that delays and reorders frames of a running daemon and its nodes, and counts them.

`Delays.environment` loads `delayed_process` into a daemon and all its child processes. The rules are a file that
every process looks at before each frame, so that they change while the daemon runs.
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
"""Below the folder of a cell."""

Place = Literal["send", "receive", "answer", "publish", "pass"]
"""Where a frame is delayed: in the thread that sends a request, on the request's way, in the thread that replies to it,
on the way of a published message, or in whatever passes a failpoint (the disk's thread, the event loop)."""


class Rule(msgspec.Struct, frozen=True):
    """Which frames are delayed, and how.

    Attributes:
        place: Where.
        key: End of the frame's key, such as ``dev/robot/cmd``, or the name of a failpoint.
        word: The payload has it, such as the name of a method; empty for every payload.
        seconds: Delay.
        times: So many frames per process.
        id: Of its own, so that no two rules are one.
    """

    place: Place
    key: str
    word: str = ""
    seconds: float = 0.0
    times: int = 1
    id: str = msgspec.field(default_factory=lambda: uuid.uuid4().hex)


class Delayed(msgspec.Struct, frozen=True):
    """A frame that was delayed.

    Attributes:
        rule: By which.
        begun: When it would have gone on, s of the machine.
        ended: When it did.
        overtaken: Frames of the same place and key that went on in the meantime.
    """

    rule: Rule
    begun: float
    ended: float
    overtaken: int


class Delays:
    """The rules of one cell's transport.

    Args:
        folder: Of its own.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def install(self) -> Mapping[str, str]:
        """Begin without rules; return the variables of a process that is delayed, which its children have, too."""
        self._folder.mkdir(parents=True, exist_ok=True)
        program = "import pcmrs_lab.campaign.delayed_process as p\n\np.install()\n"
        (self._folder / "sitecustomize.py").write_text(program)
        self._write([])
        path = os.pathsep.join(filter(None, (str(self._folder), os.environ.get("PYTHONPATH"))))
        return {VARIABLE: str(self._folder), "PYTHONPATH": path}

    @asynccontextmanager
    async def delaying(self, *rules: Rule, ended: bool = True) -> AsyncIterator[None]:
        """The rules are in force for the length of the context, beside those of contexts around it.

        Args:
            rules: That come into force.
            ended: Each must have delayed a frame to its end; otherwise the process may have ended before.

        Raises:
            Unmet: One of them has delayed nothing by the end of the context and `PATIENCE`.
        """
        self._write([*self._rules(), *rules])
        try:
            yield
            for rule in rules:
                await (self.took_place(rule) if ended else self.begins(rule))
        finally:
            self._write([rule for rule in self._rules() if rule not in rules])

    async def took_place(self, rule: Rule, count: int = 1) -> list[Delayed]:
        """Waits until a rule has delayed so many frames to their end, and returns them.

        Raises:
            Unmet: It has not within `PATIENCE`.
        """
        clock = SystemClock()
        begun = clock.monotonic()
        while len(found := [each for each in self._records() if each.rule == rule]) < count:
            if clock.monotonic() - begun > PATIENCE:
                raise Unmet(f"The fault did not take place: {rule} delayed {len(found)} frames, not {count}.")
            await clock.sleep(PERIOD)
        return found

    async def begins(self, rule: Rule) -> None:
        """Waits until a frame is being delayed by a rule.

        Raises:
            Unmet: None is within `PATIENCE`.
        """
        clock = SystemClock()
        begun = clock.monotonic()
        while rule not in self._begun():
            if clock.monotonic() - begun > PATIENCE:
                raise Unmet(f"The fault did not take place: {rule} delays nothing.")
            await clock.sleep(PERIOD / 4)

    def _rules(self) -> list[Rule]:
        return msgspec.json.decode((self._folder / "rules").read_bytes(), type=list[Rule])

    def _write(self, rules: list[Rule]) -> None:
        scratch = self._folder / "rules.new"
        scratch.write_bytes(msgspec.json.encode([] if is_sham() else rules))
        scratch.replace(self._folder / "rules")  # whole for every process that looks

    def _begun(self) -> list[Rule]:
        return [msgspec.json.decode(line, type=Rule) for line in self._lines("begun")]

    def _records(self) -> list[Delayed]:
        return [msgspec.json.decode(line, type=Delayed) for line in self._lines("done")]

    def _lines(self, name: str) -> list[bytes]:
        file = self._folder / name
        return file.read_bytes().splitlines() if file.exists() else []


def delays_of(cell: RunningCell) -> Delays:
    """Return the rules of a cell that was started as ``delayed``."""
    return Delays(cell.folder / FOLDER)
