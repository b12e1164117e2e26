"""Defects that the product once had, put back one at a time: exploring must find each, and shrink it to a few acts.

A defect is a function that takes the place of another one, which is named as ``module:Class.method``. The script that
was found for it is beside this file; it holds on the product as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest

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


def _never(_: Any) -> Any:
    def changed(*_given: Any) -> bool:
        return False

    return changed


DEFECTS: dict[str, Defect] = {
    each.name: each
    for each in (
        Defect(
            name="silence_lasts_twice_the_limit",
            harm="The deadman counts from when a beat was processed, not from the sign of life that it carries.",
            found_by=("silence_is_held",),
            put_back={
                "pcmrs.devices.deadman:Deadman.hear": _counts_from_hearing,
                "pcmrs.devices.deadman:Deadman._last_alive": _alive_when_heard,
            },
        ),
        Defect(
            name="a_crash_while_following_starts_unlatched",
            harm="What moves the robot besides operations does not count as begun.",
            found_by=("a_crash_in_motion_latches",),
            put_back={"pcmrs.service.ledger:Ledger._follow_activity": _does_nothing},
        ),
        Defect(
            name="one_stamp_ahead_ends_all_poses",
            harm="After one frame that is stamped ahead all others count as late for ever.",
            found_by=("poses_go_on",),
            put_back={"pcmrs.devices.poses:PoseFeed._is_ahead": _never},
        ),
    )
}
"""Name to defect."""
