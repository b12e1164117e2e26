"""Numbers that pages state and the code decides: each is read out of its page and compared."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pcmrs.fsm.files.load import read_blueprint
from pcmrs.fsm.verify.space import Space
from pcmrs.service.supervisor import RESTARTS, WITHIN
from pcmrs.settings import Settings

ROOT = Path(__file__).parents[2]


def stated(page: str, pattern: str) -> list[tuple[str, ...]]:
    """What the groups of a pattern say on a page, whose line breaks count as spaces; at least one place."""
    found = [match.groups() for match in re.finditer(pattern, " ".join((ROOT / page).read_text().split()))]
    assert found, f"{page} has nothing of the form {pattern!r}"
    return found


@pytest.mark.parametrize("page", ["docs/devices.md", "docs/supervision.md", "docs/architecture.md"])
def test_the_time_after_which_a_node_holds_the_robot_is_its_default(page: str) -> None:
    for (seconds,) in stated(page, r"`robot\.deadman` \(([\d.]+) s"):
        assert float(seconds) == Settings().robot.deadman


def test_a_node_is_restarted_so_often_as_the_page_says() -> None:
    assert stated("docs/devices.md", r"restarts it, at most (\d+) times within (\d+) s") == [
        (str(RESTARTS), f"{WITHIN:g}")
    ]


WORKFLOWS = stated("docs/workflows.md", r"\| `(\w+)` \| [^|]+ \| (\d+) \|")


@pytest.mark.parametrize(("name", "joint_states"), WORKFLOWS)
def test_the_joint_states_of_a_workflow_are_so_many(name: str, joint_states: str) -> None:
    file = ROOT / "pcmrs" / "workflows" / f"{name}.toml"
    blueprint, findings = read_blueprint(file.read_bytes(), file.name, file.parent)
    assert blueprint is not None, findings
    assert len(Space(blueprint, 100_000).reached) == int(joint_states)
