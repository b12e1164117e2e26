"""Defects that the product once had, put back one at a time: exploring must find each, and shrink it to a few acts.

A defect is a function that takes the place of another one, which is named as ``module:Class.method``. The script that
was found for it is beside this file; it holds on the product as it is.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest

from pcmrs.messages import Command, DeviceEvent, Reason

FOLDER = Path(__file__).parent / "defects"


@dataclass(frozen=True)
class Defect:
    """One of them.

    Attributes:
        name: Of its script, too.
        harm: What it does.
        found_by: Invariants that show it.
        put_back: Qualified name to what makes the defective function from the present one.
        workflow: In which it is looked for.
    """

    name: str
    harm: str
    found_by: tuple[str, ...]
    put_back: Mapping[str, Callable[[Any], Any]]
    workflow: str = "ratms"

    @property
    def script(self) -> Path:
        """Where its script is."""
        return FOLDER / f"{self.name}.json"

    def apply(self, patch: pytest.MonkeyPatch) -> None:
        """Puts it back.

        Raises:
            AttributeError: Something of that name is not there any more.
        """
        for name, make in self.put_back.items():
            owner, _, attribute = name.rpartition("." if "." in name.partition(":")[2] else ":")
            patch.setattr(resolve_name(owner), attribute, make(resolve_name(name)))


def _counts_from_hearing(hear: Any) -> Any:
    def changed(self: Any, beat: Any) -> None:
        number = self._number
        hear(self, beat)
        if self._number != number:
            self._heard_at = self._clock.monotonic()

    return changed


def _alive_when_heard(last_alive: Any) -> Any:
    def changed(self: Any) -> Any:
        return getattr(self, "_heard_at", None) or last_alive(self)

    return changed


def _does_nothing(_: Any) -> Any:
    def changed(*_given: Any) -> None:
        return None

    return changed


def _waits_for_nothing(_: Any) -> Any:
    async def changed(*_given: Any) -> None:
        return None

    return changed


def _never(_: Any) -> Any:
    def changed(*_given: Any) -> bool:
        return False

    return changed


def _whatever_the_newest_one_is(_: Any) -> Any:
    def changed(_self: Any, pose: Any, newest: Any) -> bool:
        return bool(pose.captured <= newest.exposed)

    return changed


def _refuses_no_motion(begin: Any) -> Any:
    def changed(self: Any, *given: Any) -> Any:
        self._motion = None
        return begin(self, *given)

    return changed


def _one_after_the_other(_: Any) -> Any:
    async def changed(self: Any) -> None:
        while self._queue:
            await asyncio.wait([self._start(self._queue.popleft())])
        self._draining = False

    return changed


def _forgets_the_arrival(submit: Any) -> Any:
    async def changed(self: Any, command: Command, **_: Any) -> Any:
        return await submit(self, command)

    return changed


def _sends_late(send_second: Any) -> Any:
    async def changed(self: Any, kind: Any, ended: Any, send: Any, _acknowledged: float) -> None:
        await send_second(self, kind, ended, send, float("inf"))

    return changed


def _submits_after_the_hold(_: Any) -> Any:
    async def changed(self: Any, event: DeviceEvent) -> None:
        if event.danger:
            await self.stop(f"device:{event.device}", Reason(code=event.code, text=event.text, fields=event.fields))
        else:
            await self.announce(event)
        self._admission.admit_event(event)

    return changed


def _turns_events_away(why_not_wait: Any) -> Any:
    def changed(self: Any, attempt: Any) -> Any:
        if attempt.spec.event and attempt.locks.writes & self._revokers and self.moving:
            return self.busy(attempt)
        return why_not_wait(self, attempt)

    return changed


def _waits_for_nothing_pending(objection: Any) -> Any:
    def changed(self: Any, command: Any, *, latched: bool) -> Any:
        pending, self._pending = self._pending, {}
        try:
            return objection(self, command, latched=latched)
        finally:
            self._pending = pending

    return changed


def _asks_the_committed_states(_: Any) -> Any:
    def changed(self: Any, branch: str, operation: str) -> Any:
        return self._engine.ask(branch, operation)

    return changed


def _takes_the_ending_as_it_was(_: Any) -> Any:
    def changed(_self: Any, _attempt: Any, ending: Any) -> Any:
        return ending

    return changed


DEFECTS: dict[str, Defect] = {
    each.name: each
    for each in (
        Defect(
            name="the_arm_starts_after_a_confirmed_stop",
            harm="A node takes a request that was made before a hold and comes after it.",
            found_by=("nothing_begins_after_its_hold", "the_arm_stays", "nothing_moves_unasked"),
            put_back={
                "pcmrs.devices.gate:Gate.check": _does_nothing,
                "pcmrs.devices.gate:Gate.admit": _does_nothing,
            },
        ),
        Defect(
            name="a_danger_event_is_refused",
            harm="The operations of a danger event come after its hold, behind an acknowledgement and the next motion.",
            found_by=("dangers_are_decided_first", "no_event_is_turned_away"),
            put_back={
                "pcmrs.dispatcher.dispatcher:Dispatcher.report": _submits_after_the_hold,
                "pcmrs.dispatcher.locks:LockManager.why_not_wait": _turns_events_away,
                "pcmrs.dispatcher.stops:Stops.objection": _waits_for_nothing_pending,
            },
        ),
        Defect(
            name="a_change_meets_the_commit_of_a_retreat",
            harm="The plan is taken away while the outcome of a retreat is written, and the standoff is committed.",
            found_by=("promises_are_kept", "the_tool_is_at_its_plan"),
            put_back={
                "pcmrs.dispatcher.procedure:Procedure.ask": _asks_the_committed_states,
                "pcmrs.dispatcher._performer:Performer._still_so": _takes_the_ending_as_it_was,
            },
        ),
        Defect(
            name="a_reused_id_gets_another_verdict",
            harm="A command with an id that another one had gets the verdict on that one.",
            found_by=("answers_are_about_the_command",),
            put_back={"pcmrs.dispatcher.verdict_cache:_check_same": _does_nothing},
        ),
        Defect(
            name="motions_queue_in_the_gateway",
            harm="Motions of a client without ids are acknowledged, and performed one after the other, however late.",
            found_by=("motions_begin_in_time",),
            put_back={
                "pcmrs.gateway.peer_session:PeerSession._begin": _refuses_no_motion,
                "pcmrs.gateway.peer_session:PeerSession._drain": _one_after_the_other,
                "pcmrs.gateway.peer_session:PeerSession._give_up": _waits_for_nothing,
                "pcmrs.gateway.peer_session:PeerSession._too_late": _does_nothing,
                "pcmrs.service.gateway_adapter:GatewayAdapter.submit": _forgets_the_arrival,
            },
        ),
        Defect(
            name="a_late_second_datagram_is_sent",
            harm="A client takes the late result of a command for the acknowledgement of its next one.",
            found_by=("no_second_is_late",),
            put_back={"pcmrs.gateway.peer_session:PeerSession._send_second": _sends_late},
        ),
        Defect(
            name="silence_lasts_twice_the_limit",
            harm="The deadman counts from when a beat was processed, not from the sign of life that it carries.",
            found_by=("silence_is_held",),
            put_back={
                "pcmrs.devices.deadman:Deadman.take_beat": _counts_from_hearing,
                "pcmrs.devices.deadman:Deadman._last_alive": _alive_when_heard,
            },
        ),
        Defect(
            name="a_crash_while_following_starts_unlatched",
            harm="What moves the robot besides operations does not count as begun.",
            found_by=("a_crash_in_motion_latches",),
            put_back={"pcmrs.service.restart.state:RestartState._follow_activity": _does_nothing},
        ),
        Defect(
            name="one_frame_ends_all_poses",
            harm="After a frame that is stamped ahead, or numbers that begin anew, no later frame is ever taken.",
            found_by=("poses_go_on",),
            put_back={
                "pcmrs.devices.lateness:Lateness.is_ahead": _never,
                "pcmrs.devices.poses:PoseFeed._is_behind": _whatever_the_newest_one_is,
                "pcmrs.devices._frame_sessions:FrameSessions._follow": _does_nothing,
            },
        ),
    )
}
"""Name to defect."""
