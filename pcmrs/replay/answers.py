"""What the world answered besides the ends of steps: that the robot stands, and that activities have ended."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from pcmrs.dispatcher.events import NOT_CONFIRMED
from pcmrs.errors import DeviceError, PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.journal import JournalRow
from pcmrs.messages import Reason, Verdict
from pcmrs.replay.keys import is_danger
from pcmrs.replay.workflow import Pursued


def _refusal(verdict: Verdict) -> PcmrsError:
    """What a release has raised, by its outcome."""
    reason = verdict.reason
    if reason is None:
        return DeviceError("The devices were not released.")
    fields = {key: value for key, value in reason.fields.items() if key != "step"}
    if verdict.decision == "unknown":
        return UnknownOutcomeError(reason.text, **fields)
    return DeviceError(reason.text, **({"code": reason.code} | fields))


class Holds:
    """Holds and releases of the devices that have not been answered yet.

    Args:
        rows: On record.
    """

    def __init__(self, rows: Sequence[JournalRow]) -> None:
        self._rows = rows
        self._asked: list[asyncio.Future[None]] = []
        self._released: list[asyncio.Future[Sequence[str]]] = []
        self._ended = False

    async def hold(self, _latch: bool) -> None:
        """Wait for the answer. Raises `DeviceError` where none came."""
        if self._ended:
            return
        asked: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._asked.append(asked)
        await asked

    async def release(self, _stopped: bool) -> Sequence[str]:
        """Wait for the release of the devices. Raises `DeviceError` where they were not released."""
        released: asyncio.Future[Sequence[str]] = asyncio.get_running_loop().create_future()
        if self._ended:
            return []
        self._released.append(released)
        return await released

    def answer_release(self, index: int) -> bool:
        """The devices are released as the outcome at `index` shows; whether anybody waited."""
        verdict = self._rows[index].verdict
        waiting, self._released = [each for each in self._released if not each.done()], []
        for each in waiting:
            if verdict is None or verdict.decision == "accepted":
                each.set_result((verdict.result or {}).get("still_latched", []) if verdict is not None else [])
            else:
                each.set_exception(_refusal(verdict))
        return bool(waiting)

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


def end_activities(pursued: Sequence[Pursued], source: str | None) -> bool:
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
