"""Verdicts by (source, id), so that a repeated command runs nothing."""

from __future__ import annotations

import asyncio
from collections import OrderedDict

from pcmrs.dispatcher.recorder import Recorder
from pcmrs.messages import Command, Verdict

MAX_REMEMBERED = 10_000
"""Verdicts kept in memory; older ones are looked up in the journal."""


class Memory:
    """Remembers what has been decided, and what is being decided."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._verdicts: OrderedDict[tuple[str, str], asyncio.Future[Verdict]] = OrderedDict()

    def verdict_of(self, command: Command) -> tuple[asyncio.Future[Verdict], bool]:
        """The verdict of a command, done or to come, and whether the command is new.

        Raises:
            JournalError: Nobody can say whether the command has been decided before.
        """
        key = (command.source, command.id)
        if key in self._verdicts:
            return self._verdicts[key], False
        recorded = self._recorder.recall(*key)
        verdict: asyncio.Future[Verdict] = asyncio.get_running_loop().create_future()
        self._verdicts[key] = verdict
        self._forget_oldest()
        if recorded is not None:
            verdict.set_result(recorded)
        return verdict, recorded is None

    def forget(self, command: Command) -> None:
        """What has been answered was not made durable: what the journal says counts."""
        self._verdicts.pop((command.source, command.id), None)

    @staticmethod
    def settle(verdict: asyncio.Future[Verdict], answer: Verdict) -> None:
        """Gives the verdict to everybody who waits for it."""
        if not verdict.done():
            verdict.set_result(answer)

    def _forget_oldest(self) -> None:
        if len(self._verdicts) > MAX_REMEMBERED:
            key, verdict = next(iter(self._verdicts.items()))
            if verdict.done():
                del self._verdicts[key]
            else:
                self._verdicts.move_to_end(key)
