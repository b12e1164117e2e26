"""The branches that the shipped workflows have in common stay the same, but for what is meant to differ."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from pcmrs.fsm.files.sequence import expand
from pcmrs.workflows import read_workflow

SHARED = ("registration", "digitization", "toolplan", "robot", "placement")

PLACEMENT = ("approach", "confirm", "nudge", "back_off", "home", "to_initial", "reinit")
PLANNING = {
    "registration": ("plan_landmarks", "register", "refine", "use_previous", "clear_landmarks", "clear_digitization"),
    "digitization": (
        *("digitize_all", "digitize_one", "redigitize_one", "reuse_previous", "reuse_previous_of"),
        "reuse_previous_except",
        *("check_landmark", "digitize_surface", "clear_surface_point", "clear_surface"),
    ),
    "toolplan": ("plan", "use_previous", "clear"),
}
NOT_IN_BONE = (
    *(f"placement.operations.{name}" for name in PLACEMENT),
    *(f"{branch}.operations.{name}" for branch, names in PLANNING.items() for name in (*names, "reinit")),
    "registration.operations.clear_registration",
    "registration.operations.reference_moved",
    "robot.operations.disconnect",
)

# A bone is fixed: the guide does not follow it, and is checked by the treatment's own operations.
NOT_FOLLOWED = (
    "placement.states",
    "placement.revocations",
    "placement.activities",
    *(f"placement.emits.{state}" for state in ("following", "guided")),
    *(f"placement.parent.compatible.{state}" for state in ("following", "guided")),
    *(f"placement.operations.{name}" for name in ("follow", "stop_following", "following_lost", "watching_lost")),
    *(f"placement.operations.{name}" for name in ("guide", "stop_guiding", "guiding_lost")),
    *(f"placement.operations.{name}" for name in ("alignment_changed", "teleoperation_changed")),
    "placement.operations.force_limit.from",
    "placement.operations.moved_unasked.from",
    *(
        f"placement.operations.{name}.{field}"
        for name in ("back_off", "home", "to_initial")
        for field in ("from", "steps")
    ),
)

MEANT = {
    "grid_mapping": {"toolplan.operations.aim"},
    "femoroplasty": {
        "toolplan.operations.plan_trajectory",
        "placement.operations.press",  # a guide is drilled through, not pressed
        *NOT_FOLLOWED,
        *(f"{name}.requires.treatment" for name in NOT_IN_BONE),
        *(f"{name}.refusal" for name in NOT_IN_BONE),
    },
}
"""What each workflow adds to, or has otherwise than, RATMS."""


@pytest.mark.parametrize("workflow", MEANT)
def test_shared_branches_differ_from_ratms_only_where_meant(workflow: str) -> None:
    ratms, other = _leaves("ratms"), _leaves(workflow)
    different = {path for path in ratms.keys() | other.keys() if ratms.get(path) != other.get(path)}
    unexpected = {path for path in different if not any(_within(path, meant) for meant in MEANT[workflow])}
    assert not unexpected, "change all, or say here why not"
    unused = {meant for meant in MEANT[workflow] if not any(_within(path, meant) for path in different)}
    assert not unused, "they do not differ there any more"


def _leaves(workflow: str) -> dict[str, Any]:
    """Everything but texts for people: dotted path to value."""
    branches = expand(read_workflow(workflow)).branches
    found = _flat({name: msgspec.to_builtins(branches[name]) for name in SHARED}, "")
    return {path: value for path, value in found if not path.endswith(".title") and ".states." not in path} | {
        f"{name}.states": list(branches[name].states) for name in SHARED
    }


def _flat(table: Any, path: str) -> Iterator[tuple[str, Any]]:
    if not isinstance(table, dict):
        yield path.removeprefix("."), table
        return
    for key, value in table.items():
        yield from _flat(value, f"{path}.{key}")


def _within(path: str, meant: str) -> bool:
    return path == meant or path.startswith(f"{meant}.")
