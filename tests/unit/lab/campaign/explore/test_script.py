"""A script survives its file, and what shows a defect is shortened until every act of it is needed."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import ConfigurationError
from pcmrs_lab.campaign.explore.script import MOST_RUNS, Act, SessionScript, read_script, shrink, write_script
from tests.support.trials import examples

FORTY = SessionScript(seed=1, acts=[Act(1.0, f"act{number}") for number in range(40)])


def needing(*names: str) -> Callable[[SessionScript], bool]:
    return lambda script: set(names) <= {act.what for act in script.acts}


def names(script: SessionScript) -> list[str]:
    return [act.what for act in script.acts]


@examples(10)
@given(needed=st.sets(st.integers(0, 39)))
def test_what_is_needed_alone_is_left_in_its_order(needed: set[int]) -> None:
    wanted = [f"act{number}" for number in sorted(needed)]
    assert names(shrink(FORTY, needing(*wanted), most=10_000)) == wanted


@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_defect_that_needs_no_act_is_shown_without_any(number: int) -> None:
    script = SessionScript(seed=1, acts=FORTY.acts[:number])
    assert names(shrink(script, lambda _: True)) == []


def test_acts_that_only_fail_together_are_kept_together() -> None:
    def fails(script: SessionScript) -> bool:
        found = set(names(script))
        return {"act1", "act2"} <= found or {"act30", "act31", "act32"} <= found

    shorter = shrink(FORTY, fails)
    assert names(shorter) in (["act1", "act2"], ["act30", "act31", "act32"])


def test_shrinking_ends_after_so_many_runs() -> None:
    runs: list[SessionScript] = []

    def fails(script: SessionScript) -> bool:
        runs.append(script)
        return random.Random(len(script.acts)).random() < 0.1

    shrink(FORTY, fails, most=7)
    assert len(runs) == 7
    runs.clear()
    shrink(FORTY, fails)
    assert len(runs) <= MOST_RUNS


def test_what_never_fails_again_stays_whole() -> None:
    assert shrink(FORTY, lambda _: False) == FORTY


def test_everything_but_the_acts_stays() -> None:
    script = SessionScript(seed=7, workflow="other", physics="mujoco", coded=True, slow=0.3, acts=FORTY.acts)
    shorter = shrink(script, needing("act5"))
    assert shorter == SessionScript(seed=7, workflow="other", physics="mujoco", coded=True, slow=0.3, acts=shorter.acts)


def test_a_script_survives_its_file(tmp_path: Path) -> None:
    acts = [Act(0.5, "wire:x", "anna", {"tokens": [1, 0.25]}, False, "send:*", 0.125), Act(0.0, "fault:e_stop")]
    script = SessionScript(seed=7, coded=True, slow=0.3, acts=acts)
    write_script(script, tmp_path / "script.json")
    assert read_script(tmp_path / "script.json") == script


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"[]",
        b'{"workflow": "ratms"}',
        b'{"seed": 1, "nonsense": 2}',
        b'{"seed": 1, "acts": [{"after": 1.0}]}',
        b'{"seed": 1, "acts": [{"after": "soon", "what": "stop"}]}',
        b'{"seed": 1, "physics": "quantum"}',
        b"\xff\xfe",
        b'{"seed": 1, "acts": ' + b"[" * 100_000,
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.json"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError, match="is not a script of a session"):
        read_script(path)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"none\.json cannot be read: No such file"):
        read_script(tmp_path / "none.json")
