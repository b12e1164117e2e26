"""Loading a blueprint: what is sound starts, and every broken rule is named with its branch and state."""

from __future__ import annotations

from pathlib import Path

import pytest
from ratms_oracle import BLUEPRINT

from pcmrs.errors import BlueprintError
from pcmrs.fsm import load_blueprint, parse_blueprint

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
states = { safe = "clear", near = "close" }
revocations = [{ by = ["top"], from = ["near"], to = "safe" }]

[branches.side.operations.move]
from = ["safe"]
to = "near"
motion = "approach"
on_failure = "safe"
on_unknown = "safe"
requires = { top = ["11"] }
"""

FAULTS = {
    # what is replaced, by what, and what the error must name: rule, branch, and state or operation
    "branch name": ("branches.side", "branches.Side", "names", "Side", "'Side'"),
    "keyword as operation": ("operations.clear]", "operations.pass]", "names", "top", "'pass'"),
    "reserved operation": ("operations.clear]", "operations.active]", "names", "top", "'active'"),
    "no states": ('states = { safe = "clear", near = "close" }', "states = {}", "names", "side", "at least one state"),
    "state name": ("near =", '"so near" =', "names", "side", "'so near'"),
    "digit for each flag": ('"ready", "finished"]', '"ready"]', "flags", "top", "state 00"),
    "a flag twice": ('"ready", "finished"]', '"ready", "ready"]', "flags", "top", "flag ready"),
    "level without parent": ("[branches.side]\nlevel = 1", "[branches.side]\nlevel = 2", "levels", "side", "level 2"),
    "parent missing": ('branch = "top"', 'branch = "roof"', "levels", "sub", "roof"),
    "parent is itself": ('branch = "top"', 'branch = "sub"', "levels", "sub", "level 2 under sub"),
    "level skipped": ("[branches.sub]\nlevel = 2", "[branches.sub]\nlevel = 3", "levels", "sub", "level 3"),
    "compatible incomplete": (', "1" = ["11"] }', " }", "levels", "sub", "['0', '1']"),
    "compatible with nothing": ('"1" = ["11"] }', '"1" = ["12"] }', "references", "sub", "12"),
    "start unknown": ('start = "10"', 'start = "99"', "references", "sub", "99"),
    "from unknown": ('from = ["safe"]', 'from = ["far"]', "references", "side", "far"),
    "from empty": ('from = ["safe"]', "from = []", "operations", "side", "move: `from`"),
    "from star and more": ('from = ["safe"]', 'from = ["*", "safe"]', "operations", "side", "move: `from`"),
    "to unknown": ('to = "near"\nmotion', 'to = "far"\nmotion', "references", "side", "far"),
    "neither to nor outcomes": ('to = "near"\nmotion', "motion", "operations", "side", "move"),
    "both to and outcomes": (
        'to = "near"\nmotion',
        'to = "near"\noutcomes = { a = { to = "near" } }\nmotion',
        "operations",
        "side",
        "move",
    ),
    "no time": ("motion =", "timeout_s = 0\nmotion =", "operations", "side", "timeout_s is 0"),
    "time is no number": ("motion =", "timeout_s = nan\nmotion =", "operations", "side", "timeout_s is nan"),
    "time without end": ("motion =", "timeout_s = inf\nmotion =", "operations", "side", "timeout_s is inf"),
    "motion without failure": ('on_failure = "safe"\n', "", "operations", "side", "on_failure"),
    "motion without doubt": ('on_unknown = "safe"\n', "", "operations", "side", "on_unknown"),
    "failure unknown": ('on_failure = "safe"', 'on_failure = "far"', "references", "side", "far"),
    "iio with steps": ('to = "11"\niio = true', 'to = "11"\niio = true\nsteps = ["a"]', "operations", "top", "reached"),
    "requires unknown branch": ('{ top = ["11"] }', '{ tip = ["11"] }', "references", "side", "tip"),
    "requires unknown state": ('{ top = ["11"] }', '{ top = ["77"] }', "references", "side", "77"),
    "sets no child": (
        "[branches.top.operations.clear]",
        '[branches.top.operations.clear]\nsets = { side = "safe" }',
        "operations",
        "top",
        "sets side",
    ),
    "revoked by nobody": ('by = ["top"]', 'by = ["tip"]', "references", "side", "tip"),
    "revoked to nowhere": ('from = ["near"], to = "safe"', 'from = ["near"], to = "far"', "references", "side", "far"),
    "rule 1, no rio": ("rio = true", "", "rule 1", "sub", "re-initiation"),
    "rule 1, one state without": ('from = ["*"]\nto = "0"', 'from = ["0"]\nto = "0"', "rule 1", "sub", "state 1"),
    "rule 1, not to the start": ('to = "0"\nrio', 'to = "1"\nrio', "rule 1", "sub", "not to the start 0"),
    "rule 2, silent": (', "1" = "reached" }', " }", "rule 2", "sub", "state 1"),
    "rule 2, no such operation": ('"1" = "reached"', '"1" = "arrived"', "rule 2", "sub", "arrived"),
    "rule 2, not incoming": ('"1" = "reached"', '"1" = "prepare"', "rule 2", "sub", "prepare"),
    "rule 2, state unknown": ('"1" = "reached" }', '"1" = "reached", "2" = "lost" }', "rule 2", "sub", "state 2"),
    "rule 3, start does not fit": ('"0" = ["00", "10"]', '"0" = ["00"]', "rule 3", "sub", "does not fit top 10"),
    "rule 3, first state": ('"0" = ["00", "10"]', '"0" = ["10"]', "rule 3", "sub", "start of top"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_broken_rule_is_named(fault: str) -> None:
    old, new, rule, branch, fragment = FAULTS[fault]
    assert old in SOUND
    with pytest.raises(BlueprintError) as caught:
        parse_blueprint(SOUND.replace(old, new).encode(), origin="small.toml")
    assert caught.value.fields["rule"] == rule
    assert caught.value.fields["branch"] == branch
    assert fragment in caught.value.text
    assert caught.value.text.startswith(f"small.toml: {rule}: branch {branch}:")


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


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('version = "1"', 'version = "1"\nauthor = "me"'),
        ("[branches.side]", "[branches.side]\ncolour = 1"),
        ('motion = "approach"', 'motion = "approach"\nwhen = "now"'),
        ('start = "10"', 'start = "10", stop = "11"'),
        ('by = ["top"]', 'by = ["top"], unless = ["sub"]'),
        ('motion = "approach"', 'motion = "sideways"'),
        ("level = 2", 'level = "2"'),
        ('start = "10"', "start = 10"),
    ],
)
def test_unknown_keys_and_wrong_types_are_refused(old: str, new: str) -> None:
    with pytest.raises(BlueprintError, match=r"^small\.toml: (Object|Expected|Invalid)"):
        parse_blueprint(SOUND.replace(old, new).encode(), origin="small.toml")


def test_unreadable_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BlueprintError, match="cannot be read"):
        load_blueprint(tmp_path / "absent.toml")
    with pytest.raises(BlueprintError, match="not TOML"):
        parse_blueprint(b"id = ")
    with pytest.raises(BlueprintError, match="not UTF-8 at byte 5"):
        parse_blueprint(b"id ='\xff'")
    with pytest.raises(BlueprintError, match="at least one branch"):
        parse_blueprint(b'id = "x"\nversion = "1"\nbranches = {}')


def test_a_cascade_without_end_is_refused() -> None:
    """Two branches that revoke each other for ever."""
    ring = """
    id = "ring"
    version = "1"
    [branches.a]
    level = 1
    states = { x = "", y = "" }
    revocations = [{ by = ["b"], from = ["x"], to = "y" }, { by = ["b"], from = ["y"], to = "x" }]
    operations.flip = { from = ["x"], to = "y" }
    [branches.b]
    level = 1
    states = { x = "", y = "" }
    revocations = [{ by = ["a"], from = ["x"], to = "y" }, { by = ["a"], from = ["y"], to = "x" }]
    operations.flip = { from = ["x"], to = "y" }
    """
    with pytest.raises(BlueprintError, match=r"a\.flip .* triggers over 64 effects"):
        parse_blueprint(ring.encode())


def test_an_operation_that_could_never_end_is_refused() -> None:
    text = SOUND.replace(
        'to = "near"\nmotion', 'outcomes = { there = { to = "near", requires = { sub = ["0"] } } }\nmotion'
    )
    with pytest.raises(BlueprintError, match=r"side\.move .* cannot end"):
        parse_blueprint(text.encode())
