"""Loading a blueprint: what is sound starts, and every broken rule is named with its branch and state."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import BlueprintError
from pcmrs.fsm import examine, load_blueprint, parse_blueprint
from tests.support.ratms_oracle import BLUEPRINT

SOUND = """
id = "small"
version = "1"

[branches.top]
level = 1
flags = ["ready", "finished"]
states = { "00" = "idle", "10" = "ready", "11" = "finished" }

[branches.top.operations.prepare]
from = ["*"]
to = "10"

[branches.top.operations.clear]
from = ["10", "11"]
to = "00"
unlatches = true

[branches.top.operations.reached]
from = ["10", "11"]
to = "11"
iio = true

[branches.top.operations.lost]
from = ["10", "11"]
to = "10"
iio = true

[branches.sub]
level = 2
states = { "0" = "open", "1" = "closed" }
emits = { "0" = "lost", "1" = "reached" }
parent = { branch = "top", start = "10", compatible = { "0" = ["00", "10"], "1" = ["11"] } }

[branches.sub.operations.finish]
from = ["0"]
to = "1"

[branches.sub.operations.reinit]
from = ["*"]
to = "0"
rio = true

[branches.side]
level = 1
states = { safe = "clear", near = "close", held = "stopped" }
revocations = [{ by = ["top"], from = ["near"], to = "safe" }]

[branches.side.operations.move]
from = ["safe"]
to = "near"
motion = "approach"
steps = ["follow"]
on_failure = "held"
on_unknown = "held"
requires = { top = ["11"] }

[branches.side.operations.withdraw]
from = ["near", "held"]
to = "safe"
"""

FAULTS = {
    # what is replaced, by what, the code of the finding, a word of its text, and the text of the line it points to
    "workflow name": ('id = "small"', 'id = "Small one"', "bad_name", "'Small one'", 'id = "Small one"'),
    "version": ('version = "1"', 'version = ""', "bad_name", "version", "version"),
    "branch name": ("branches.side", "branches.Side", "bad_name", "'Side'", "[branches.Side]"),
    "bus syntax": ("operations.clear]", "operations.'a/*']", "bad_name", "'a/*'", "a/*"),
    "keyword": ("operations.clear]", "operations.pass]", "reserved_name", "'pass'", "operations.pass"),
    "reserved operation": ("operations.clear]", "operations.active]", "reserved_name", "'active'", "active"),
    "reserved outcome": (
        'to = "near"\nmotion',
        'outcomes = { failed = { to = "near" } }\nmotion',
        "reserved_name",
        "'failed'",
        "outcomes",
    ),
    "one class for two": ("[branches.side]", "[branches.to_p]\n[branches.side]", "no_states", "to_p", "to_p"),
    "no states": (
        'states = { safe = "clear", near = "close", held = "stopped" }',
        "states = {}",
        "no_states",
        "side",
        "[branches.side]",
    ),
    "state name": ("near =", '"so near" =', "bad_name", "'so near'", "so near"),
    "digit for each flag": ('"ready", "finished"]', '"ready"]', "bad_flags", "state 00", '"00"'),
    "a flag twice": ('"ready", "finished"]', '"ready", "ready"]', "name_collision", "flag ready", "flags"),
    "level without parent": (
        "[branches.side]\nlevel = 1",
        "[branches.side]\nlevel = 2",
        "bad_level",
        "side",
        "level",
    ),
    "parent missing": ('branch = "top"', 'branch = "roof"', "unknown_branch", "roof", "parent"),
    "parent is itself": ('branch = "top"', 'branch = "sub"', "unknown_state", "sub", "parent"),
    "level skipped": ("[branches.sub]\nlevel = 2", "[branches.sub]\nlevel = 3", "bad_level", "level 3", "level = 3"),
    "compatible incomplete": (', "1" = ["11"] }', " }", "bad_level", "missing: 1", "compatible"),
    "compatible with nothing": ('"1" = ["11"] }', '"1" = ["12"] }', "unknown_state", "'12'", "compatible"),
    "start unknown": ('start = "10"', 'start = "99"', "unknown_state", "'99'", "start"),
    "from unknown": ('from = ["safe"]', 'from = ["far"]', "unknown_state", "'far'", "from"),
    "from empty": ('from = ["safe"]', "from = []", "bad_operation", "`from`", "side.operations.move"),
    "from star and more": ('from = ["safe"]', 'from = ["*", "safe"]', "bad_operation", "`from`", "operations.move"),
    "to unknown": ('to = "near"\nmotion', 'to = "far"\nmotion', "unknown_state", "'far'", "to ="),
    "target of another source": (
        'to = "near"\nmotion',
        'to = { near = "near" }\nmotion',
        "bad_operation",
        "['safe'], not ['near']",
        "operations.move",
    ),
    "neither to nor outcomes": ('to = "near"\nmotion', "motion", "bad_operation", "outcomes", "operations.move"),
    "both to and outcomes": (
        'to = "near"\nmotion',
        'to = "near"\noutcomes = { a = { to = "near" } }\nmotion',
        "bad_operation",
        "`outcomes`",
        "operations.move",
    ),
    "no time": ("motion =", "timeout_s = 0\nmotion =", "bad_operation", "timeout_s = 0", "operations.move"),
    "time is no number": ("motion =", "timeout_s = nan\nmotion =", "bad_operation", "nan", "operations.move"),
    "time without end": ("motion =", "timeout_s = inf\nmotion =", "bad_operation", "inf", "operations.move"),
    "event that moves": ("motion =", "event = true\nmotion =", "bad_operation", "no user asks", "operations.move"),
    "motion without failure": ('on_failure = "held"\n', "", "bad_operation", "on_failure", "operations.move"),
    "motion without doubt": ('on_unknown = "held"\n', "", "bad_operation", "on_unknown", "operations.move"),
    "motion without steps": ('steps = ["follow"]\n', "", "bad_operation", "no steps", "operations.move"),
    "motion that fails to where it began": (
        'on_failure = "held"',
        'on_failure = "safe"',
        "bad_operation",
        "may fail to safe, where the approach move is valid",
        "operations.move",
    ),
    "only a motion could release Stop": (
        "unlatches = true\n",
        "unlatches = true\naffects_patient = true\n",
        "no_release",
        "neither moves nor affects the patient",
        "operations.clear",
    ),
    "failure unknown": ('on_failure = "held"', 'on_failure = "far"', "unknown_state", "'far'", "on_failure"),
    "iio with steps": (
        'to = "11"\niio = true',
        'to = "11"\niio = true\nsteps = ["a"]',
        "bad_operation",
        "iio",
        "reached",
    ),
    "iio as event": (
        'to = "11"\niio = true',
        'to = "11"\niio = true\nevent = true',
        "bad_operation",
        "(iio)",
        "top.operations.reached",
    ),
    "requires unknown branch": ('{ top = ["11"] }', '{ tip = ["11"] }', "unknown_branch", "'tip'", "requires"),
    "requires unknown state": ('{ top = ["11"] }', '{ top = ["77"] }', "unknown_state", "'77'", "requires"),
    "sets no child": (
        "[branches.top.operations.clear]",
        '[branches.top.operations.clear]\nsets = { side = "safe" }',
        "bad_operation",
        "sets side",
        "operations.clear",
    ),
    "revoked by nobody": ('by = ["top"]', 'by = ["tip"]', "unknown_branch", "'tip'", "revocations"),
    "revoked to nowhere": (
        'from = ["near"], to = "safe"',
        'from = ["near"], to = "far"',
        "unknown_state",
        "'far'",
        "to",
    ),
    "goal unknown": ('version = "1"', 'version = "1"\ngoal = { top = ["12"] }', "unknown_state", "'12'", "goal"),
    "property of nothing": (
        'version = "1"',
        'version = "1"\n[[properties]]\nid = "p"',
        "bad_property",
        "exactly one",
        "properties",
    ),
    "property without a name": (
        'version = "1"',
        'version = "1"\n[[properties]]\nid = ""\nnever = { states = { top = ["10"] } }',
        "bad_name",
        "a property",
        "id =",
    ),
    "property of no state": (
        'version = "1"',
        'version = "1"\n[[properties]]\nid = "p"\nnever = { states = { top = [] } }',
        "unknown_state",
        "can never hold",
        "never",
    ),
    "property of no operation": (
        'version = "1"',
        'version = "1"\n[[properties]]\nid = "p"\nalways = { running = ["side.fly"] }',
        "unknown_operation",
        "'side.fly'",
        "always",
    ),
    "sequence of nothing": (
        "[branches.side]",
        "[branches.row]\nsequence = {}\n[branches.side]",
        "bad_sequence",
        "`count` or `items`",
        "seq",
    ),
    "rule 1, no rio": ("rio = true", "", "rule_1", "sub", "[branches.sub]"),
    "rule 1, two": (
        "[branches.side]",
        "[branches.sub.operations.again]\nfrom = ['*']\nto = '0'\nrio = true\n[branches.side]",
        "rule_1",
        "again",
        "again",
    ),
    "rule 1, one state without": ('from = ["*"]\nto = "0"', 'from = ["0"]\nto = "0"', "rule_1", "in 1", "from"),
    "rule 1, not to the start": ('to = "0"\nrio', 'to = "1"\nrio', "rule_1", "the start 0", "reinit"),
    "rule 2, silent": (', "1" = "reached" }', " }", "rule_2", "to 1", "emits"),
    "rule 2, no such operation": ('"1" = "reached"', '"1" = "arrived"', "unknown_operation", "arrived", "emits"),
    "rule 2, not incoming": ('"1" = "reached"', '"1" = "prepare"', "rule_2", "prepare", "emits"),
    "rule 2, state unknown": (
        '"1" = "reached" }',
        '"1" = "reached", "2" = "lost" }',
        "unknown_state",
        "'2'",
        "emits",
    ),
    "rule 3, start does not fit": ('"0" = ["00", "10"]', '"0" = ["00"]', "rule_3", "top 10", "compatible"),
    "rule 3, first state": ('"0" = ["00", "10"]', '"0" = ["10"]', "rule_3", "top 00", "compatible"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_where_it_is(fault: str) -> None:
    old, new, code, fragment, line = FAULTS[fault]
    assert old in SOUND
    text = SOUND.replace(old, new)
    with pytest.raises(BlueprintError) as caught:
        parse_blueprint(text.encode(), origin="small.toml")
    finding = caught.value.fields["findings"][0]
    assert finding.code == code
    assert fragment in finding.text
    assert line in text.split("\n")[finding.line - 1]
    assert str(finding).startswith(f"small.toml:{finding.line}:{finding.column}: {code}: ")
    assert str(finding) in caught.value.text


def test_two_branches_of_one_class_are_refused() -> None:
    text = 'id = "x"\nversion = "1"\n' + "".join(
        f'[branches.{name}]\nstates = {{ a = "" }}\n' for name in ("tool_1", "tool1")
    )
    findings = examine(text.encode()).findings
    assert [(finding.code, finding.line) for finding in findings] == [("name_collision", 5)]


def test_the_sound_blueprint_loads() -> None:
    blueprint = parse_blueprint(SOUND.encode())
    assert list(blueprint.branches) == ["top", "sub", "side"]
    assert blueprint.revokers == {"top"}
    assert list(blueprint.children["top"]) == ["sub"]
    assert len(blueprint.hash) == 64


def test_states_written_with_zeros_stay_text() -> None:
    unquoted = SOUND.replace('"00" = "idle"', '00 = "idle"')
    for text in (SOUND, unquoted):
        assert list(parse_blueprint(text.encode()).branches["top"].states) == ["00", "10", "11"]
    assert list(load_blueprint(BLUEPRINT).branches["registration"].states) == ["000", "100", "110", "111"]


def test_hash_covers_the_meaning_of_a_blueprint_not_its_layout() -> None:
    rewritten = "# reviewed\n" + SOUND.replace("\n\n", "\n\n\n").replace('"idle"', "'idle'")
    changed = SOUND.replace('"idle"', '"idling"')
    original = parse_blueprint(SOUND.encode()).hash
    top, sub = SOUND.index("[branches.top]"), SOUND.index("[branches.sub]")
    assert parse_blueprint((SOUND[:top] + SOUND[sub:] + SOUND[top:sub]).encode()).hash == original
    other_start = SOUND.replace('safe = "clear", near = "close"', 'near = "close", safe = "clear"')
    assert parse_blueprint(other_start.encode()).hash != original
    assert parse_blueprint(rewritten.encode()).hash == original
    assert parse_blueprint(changed.encode()).hash != original


def test_an_absent_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BlueprintError, match="cannot be read"):
        load_blueprint(tmp_path / "absent.toml")
