"""The newest Stop in words: what was stopped, by whom, why, and what to check before it is released. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from pcmrs.fsm import Blueprint
from pcmrs.messages import DeviceEvent, Snapshot, Verdict


@dataclass(frozen=True, slots=True)
class StopReport:
    """One Stop.

    Attributes:
        number: Number of the Stop.
        by: Who or which device has stopped; empty if this console has not seen it.
        why: Reason; empty if this console has not seen it.
        stopped: Operations that it has ended, ``branch.operation``.
        checks: Keys of the texts that say what to check.
    """

    number: int
    by: str = ""
    why: str = ""
    stopped: tuple[str, ...] = ()
    checks: tuple[str, ...] = ()


def stop_report(
    shown: Snapshot, events: Iterable[tuple[float, Verdict | DeviceEvent]], blueprint: Blueprint
) -> StopReport | None:
    """Return the newest Stop; None while none is latched.

    Args:
        shown: The present snapshot.
        events: Decisions and device events with their wall time, oldest first.
        blueprint: The workflow.
    """
    if not shown.latched:
        return None
    number, by, why = shown.stop.number, "", ""
    ended: list[Verdict] = []
    for _, event in events:
        if isinstance(event, Verdict):
            if _was_ended(event, why):
                ended.append(event)
        elif event.danger and event.fields.get("stop") == number:
            by, why = event.device, event.text
    stopped = tuple(dict.fromkeys(f"{each.branch}.{each.operation}" for each in ended))
    return StopReport(number, by, why, stopped, tuple(_checks(shown, blueprint, stopped)))


def _was_ended(verdict: Verdict, why: str) -> bool:
    """Return true for a verdict by the Stop with this text; the caller looks only at those after that Stop.

    An earlier Stop of the same user has the same text.
    """
    return verdict.decision in ("failed", "unknown") and verdict.reason is not None and verdict.reason.text == why != ""


def _checks(shown: Snapshot, blueprint: Blueprint, stopped: tuple[str, ...]) -> Iterable[str]:
    if not shown.stop.confirmed:
        yield "check_standstill"
    if blueprint.uses_robot:
        yield "check_arm"
    specs = [blueprint.find(*name.split(".")) for name in stopped]
    if any(spec is not None and spec.affects_patient for spec in specs):
        yield "check_patient"
    if shown.unknown:
        yield "check_unknown"
    yield "check_cause"
