"""Answers of the devices besides the ends of steps: the robot stands still, and activities have ended."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from pcmrs.dispatcher.events import NOT_CONFIRMED
from pcmrs.errors import DeviceError, PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.journal import JournalRow
from pcmrs.messages import Reason, Verdict
from pcmrs.replay._keys import is_danger
from pcmrs.replay._workflow import PendingActivity


def _refusal(verdict: Verdict) -> PcmrsError:
    """Return the error that a release raised, from its outcome."""
    reason = verdict.reason
    if reason is None:
        return DeviceError("The devices were not released.")
    fields = {key: value for key, value in reason.fields.items() if key != "step"}
    if verdict.decision == "unknown":
        return UnknownOutcomeError(reason.text, **fields)
    return DeviceError(reason.text, **({"code": reason.code} | fields))


class Holds:
    """Pending holds and releases of the devices.

    Args:
        rows: Journalled rows of the run.
    """

    def __init__(self, rows: Sequence[JournalRow]) -> None:
        self._rows = rows
        self._pending: list[asyncio.Future[None]] = []
        self._released: list[asyncio.Future[Sequence[str]]] = []
        self._ended = False

    async def hold(self, _latch: bool) -> None:
        """Wait for the answer. Raises `DeviceError` if there was none."""
        if self._ended:
            return
        answered: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._pending.append(answered)
        await answered

    async def release(self, _stopped: bool) -> Sequence[str]:
        """Wait for the release of the devices. Raises `DeviceError` if they were not released."""
        released: asyncio.Future[Sequence[str]] = asyncio.get_running_loop().create_future()
        if self._ended:
            return []
        self._released.append(released)
        return await released

    def answer_release(self, index: int) -> bool:
        """Answer the releases as the outcome at `index` shows; return whether there were any."""
        verdict = self._rows[index].verdict
        waiting, self._released = [each for each in self._released if not each.done()], []
        for each in waiting:
            if verdict is None or verdict.decision == "accepted":
                each.set_result((verdict.result or {}).get("still_latched", []) if verdict is not None else [])
            else:
                each.set_exception(_refusal(verdict))
        return bool(waiting)

    def answer(self, index: int) -> bool:
        """Answer the holds: confirmed, unless the row at `index` shows otherwise; return whether there were any."""
        return self._answer(confirmed=self._is_confirmed(index))

    def end(self) -> None:
        """Confirm all holds, and later ones at once."""
        self._ended = True
        self._answer(confirmed=True)

    def _answer(self, *, confirmed: bool) -> bool:
        waiting, self._pending = [each for each in self._pending if not each.done()], []
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


def end_activities(activities: Sequence[PendingActivity], source: str | None) -> bool:
    """End the activities that were asked to end: the one that is the source, or else all.

    Args:
        activities: Pending activities.
        source: Source of the row that shows the end.

    Returns:
        True if there was any.
    """
    waiting = [each for each in activities if each.end_requested.is_set() and not each.end_allowed.done()]
    for each in [each for each in waiting if source == f"activity:{each.name}"] or waiting:
        each.end_allowed.set_result(None)
    return bool(waiting)


def end_unrequested(activities: Sequence[PendingActivity], name: str, reason: Reason) -> None:
    """End an activity that was not asked to end, or that ends with another reason.

    Args:
        activities: Pending activities.
        name: Name of the activity.
        reason: Reason of its end.
    """
    for each in activities:
        ending = each.end_allowed if each.end_requested.is_set() else each.unrequested_end
        if each.name != name or ending.done():
            continue
        if reason.code == "activity_ended":
            ending.set_result(None)
        elif reason.code == "activity_raised":
            ending.set_exception(RuntimeError(reason.text))
        else:
            ending.set_exception(RefusalError(reason.code, reason.text))
