"""What the world answered besides the ends of steps: that the robot stands, and that activities have ended."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from pcmrs.dispatcher.events import NOT_CONFIRMED
from pcmrs.errors import DeviceError, RefusalError
from pcmrs.journal import JournalRow
from pcmrs.messages import Reason
from pcmrs.replay.keys import is_danger
from pcmrs.replay.recorded import Pursued


class Holds:
    """Holds that have not been answered yet.

    Args:
        rows: On record.
    """

    def __init__(self, rows: Sequence[JournalRow]) -> None:
        self._rows = rows
        self._asked: list[asyncio.Future[None]] = []
        self._ended = False

    async def hold(self, _latch: bool) -> None:
        """Waits for the answer. Raises `DeviceError` where none came."""
        if self._ended:
            return
        asked: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._asked.append(asked)
        await asked

    def answer(self, index: int) -> bool:
        """The robot stands, or does not confirm it where the row at `index` shows that; whether anybody waited."""
        return self._answer(confirmed=self._is_confirmed(index))

    def end(self) -> None:
        """All stands, from now on at once."""
        self._ended = True
        self._answer(confirmed=True)

    def _answer(self, *, confirmed: bool) -> bool:
        waiting, self._asked = [each for each in self._asked if not each.done()], []
        for each in waiting:
            if confirmed:
                each.set_result(None)
            else:
                each.set_exception(DeviceError("The robot has not confirmed that it stands."))
        return bool(waiting)

    def _is_confirmed(self, index: int) -> bool:
        row = self._rows[index]
        if row.verdict is not None and row.verdict.decision == "unknown":
            return False
        danger = next((each for each in self._rows[index:] if is_danger(each)), None)
        return danger is None or danger.operation != NOT_CONFIRMED


def quieten(pursued: Sequence[Pursued], source: str | None) -> bool:
    """Activities that were told to end have ended: the one that is `source`, or else all; whether there was any."""
    waiting = [each for each in pursued if each.told.is_set() and not each.quiet.done()]
    for each in [each for each in waiting if source == f"activity:{each.name}"] or waiting:
        each.quiet.set_result(None)
    return bool(waiting)


def end_by_itself(pursued: Sequence[Pursued], name: str, reason: Reason) -> None:
    """An activity ends without having been told to, or in another way than it was told to."""
    for each in pursued:
        ending = each.quiet if each.told.is_set() else each.by_itself
        if each.name != name or ending.done():
            continue
        if reason.code == "activity_ended":
            ending.set_result(None)
        elif reason.code == "activity_raised":
            ending.set_exception(RuntimeError(reason.text))
        else:
            ending.set_exception(RefusalError(reason.code, reason.text))
