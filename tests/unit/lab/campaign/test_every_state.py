"""O1 finds what it is for: a guard that is missing, anywhere."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

import pcmrs
from pcmrs.fsm import Blueprint, load_blueprint
from pcmrs_lab.campaign.every_state import walk
from tests.support.altered import with_operation

RATMS = load_blueprint(Path(pcmrs.__file__).parent / "workflows" / "ratms.toml")


def small() -> Blueprint:
    """Registration, digitization and tool plan alone: few joint states."""
    names = ("registration", "digitization", "toolplan")
    branches = {name: RATMS.branches[name] for name in names}
    for name, branch in branches.items():
        freed = {key: msgspec.structs.replace(spec, requires={}) for key, spec in branch.operations.items()}
        branches[name] = msgspec.structs.replace(branch, operations=freed)
    return msgspec.structs.replace(RATMS, branches=branches, properties=[])


async def test_a_workflow_that_decides_as_declared_has_nothing_wrong(tmp_path: Path) -> None:
    found = await walk(small(), tmp_path)
    assert found.wrong == []
    assert found.joint_states == 8
    assert found.forbidden > 50


@pytest.mark.parametrize(
    ("branch", "operation", "fields"),
    [
        ("registration", "register", {"from_": ["100", "110", "111"]}),
        ("registration", "clear_registration", {"from_": ["*"]}),
        ("digitization", "redigitize_one", {"from_": ["*"]}),
    ],
)
async def test_a_guard_that_is_missing_is_found(
    tmp_path: Path, branch: str, operation: str, fields: dict[str, list[str]]
) -> None:
    found = await walk(small(), tmp_path, with_operation(small(), branch, operation, **fields))
    assert found.wrong
    assert all(f"{branch}.{operation}" in wrong for wrong in found.wrong)
