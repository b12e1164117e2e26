"""Loading a blueprint file: what it means, its hash, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import BlueprintError
from pcmrs.fsm import load_blueprint, parse_blueprint
from tests.support.ratms_oracle import BLUEPRINT
from tests.unit.fsm.arm_workflow import ARM, arm_blueprint
from tests.unit.fsm.rules.small_workflow import SMALL, check_fault


def test_states_written_with_zeros_stay_text() -> None:
    unquoted = SMALL.replace('"00" = "idle"', '00 = "idle"')
    for text in (SMALL, unquoted):
        assert list(parse_blueprint(text.encode()).branches["top"].states) == ["00", "10", "11"]
    assert list(load_blueprint(BLUEPRINT).branches["registration"].states) == ["000", "100", "110", "111"]


def test_hash_covers_the_meaning_of_a_blueprint_not_its_layout() -> None:
    rewritten = "# reviewed\n" + SMALL.replace("\n\n", "\n\n\n").replace('"idle"', "'idle'")
    changed = SMALL.replace('"idle"', '"idling"')
    original = parse_blueprint(SMALL.encode()).hash
    top, sub = SMALL.index("[branches.top]"), SMALL.index("[branches.sub]")
    assert parse_blueprint((SMALL[:top] + SMALL[sub:] + SMALL[top:sub]).encode()).hash == original
    other_start = SMALL.replace('safe = "clear", near = "close"', 'near = "close", safe = "clear"')
    assert parse_blueprint(other_start.encode()).hash != original
    assert parse_blueprint(rewritten.encode()).hash == original
    assert parse_blueprint(changed.encode()).hash != original


def test_an_absent_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BlueprintError, match="cannot be read"):
        load_blueprint(tmp_path / "absent.toml")


def test_the_hash_is_of_activities_too() -> None:
    changed = ARM.replace("watch_head", "see_head")
    assert parse_blueprint(changed.encode()).hash != arm_blueprint().hash


def test_a_sequence_of_nothing_is_refused_where_it_is() -> None:
    sequence = "[branches.row]\nsequence = {}\n[branches.side]"
    check_fault(("[branches.side]", sequence, "bad_sequence", "`count` or `items`", "seq"))
