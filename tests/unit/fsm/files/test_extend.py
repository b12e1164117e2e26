"""A blueprint that extends the one beside it: what results, what is refused, and where findings point."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.cli import main
from pcmrs.errors import BlueprintError
from pcmrs.fsm import Blueprint, Finding, examine, load_blueprint, parse_blueprint
from pcmrs.fsm.files.dump import blueprint_toml
from pcmrs.fsm.files.toml import MAX_BYTES
from tests.support.shipped import shipped_blueprint
from tests.support.trials import examples
from tests.unit.fsm.files.pump_workflow import PUMP

BASE = """
id = "base"
version = "1"
title = "The base"
goal = { door = ["open"] }
migrations = [{ version = "0", hash = "00", why = "nothing changed" }]

[defaults.procedure.limits]
width = 1.0
height = 2.0

[branches.door]
states = { shut = "shut", open = "open" }
revocations = [{ by = ["power"], from = ["open"], to = "shut" }]

[branches.door.operations.open]
from = ["shut"]
to = "open"
requires = { power = ["on"] }

[branches.door.operations.close]
from = ["open"]
to = "shut"
unlatches = true

[branches.power]
states = { off = "off", on = "on" }

[branches.power.operations.switch]
from = ["*"]
to = { off = "on", on = "off" }

[[properties]]
id = "can_open"
reachable = { states = { door = ["open"] } }

[[properties]]
id = "powered"
when = { running = ["door.open"] }
always = { states = { power = ["on"] } }
"""

OWN = """
extends = "base.toml"
id = "own"
version = "2"

[defaults.procedure.limits]
height = 3.0

[branches.door.states]
ajar = "a little open"

[branches.door.operations.open]
title = "Open it"

[branches.door.operations.pull]
from = ["shut", "open"]
to = "ajar"

[branches.door.operations.close]
from = ["open", "ajar"]

[[branches.door.revocations]]
by = ["power"]
from = ["ajar"]
to = "shut"

[branches.lamp]
states = { dark = "dark", lit = "lit" }

[branches.lamp.operations.toggle]
from = ["*"]
to = { dark = "lit", lit = "dark" }

[[properties]]
id = "can_light"
reachable = { states = { lamp = ["lit"] } }

[[properties]]
id = "can_open"
text = "It can be opened with the lamp lit."
reachable = { states = { door = ["open"], lamp = ["lit"] } }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "base.toml").write_text(BASE)
    (tmp_path / "own.toml").write_text(OWN)
    return tmp_path


def load(folder: Path) -> Blueprint:
    return load_blueprint(folder / "own.toml")


def only(raw: str | bytes, folder: Path | None) -> Finding:
    raw = raw.encode() if isinstance(raw, str) else raw
    (finding,) = examine(raw, origin="folder/own.toml", folder=folder).findings
    return finding


def test_tables_merge_and_anything_else_replaces(folder: Path) -> None:
    own = load(folder)
    assert own.defaults == {"procedure": {"limits": {"width": 1.0, "height": 3.0}}}
    door = own.branches["door"]
    assert list(door.states) == ["shut", "open", "ajar"]
    assert list(own.branches) == ["door", "power", "lamp"]
    assert (door.operations["open"].title, door.operations["open"].requires) == ("Open it", {"power": ["on"]})
    assert (door.operations["close"].from_, door.operations["close"].unlatches) == (["open", "ajar"], True)


def test_properties_are_added_or_replaced_and_revocations_added(folder: Path) -> None:
    """A property of the same id is replaced."""
    own = load(folder)
    assert [promise.id for promise in own.properties] == ["can_open", "powered", "can_light"]
    assert own.properties[0].text == "It can be opened with the lamp lit."
    assert [rule.from_ for rule in own.branches["door"].revocations] == [["open"], ["ajar"]]


def test_identity_of_the_workflow_is_not_inherited(folder: Path) -> None:
    own = load(folder)
    assert (own.id, own.version, own.title, own.goal, own.migrations) == ("own", "2", "", {}, [])


def test_hash_covers_the_resulting_blueprint(folder: Path) -> None:
    """Oracle: the same written as one file; and a change of the file below is a change."""
    before = load(folder)
    assert parse_blueprint(blueprint_toml(before).encode()) == before
    (folder / "base.toml").write_text(f"# The same again.\n{BASE}")
    assert load(folder) == before
    (folder / "base.toml").write_text(BASE.replace("width = 1.0", "width = 1.5"))
    assert load(folder).hash != before.hash


FAULTS = {
    # what is replaced in which file, by what; the code, the file and the line that the finding points to
    "key of the own file": ("own", 'title = "Open it"', 'titel = "Open it"', "bad_value", "own", "titel"),
    "key of the file below": ("base", "unlatches = true", "unlatch = true", "bad_value", "base", "unlatch ="),
    "value over one below": (
        "own",
        "height = 3.0\n",
        'height = 3.0\n[branches.power]\nlevel = "2"',
        "bad_value",
        "own",
        'level = "2"',
    ),
    "state of the own revocation": ("own", 'from = ["ajar"]', 'from = ["wide"]', "unknown_state", "own", "wide"),
    "state of the revocation below": (
        "base",
        'from = ["open"], to = "shut"',
        'from = ["wide"], to = "shut"',
        "unknown_state",
        "base",
        "wide",
    ),
    "property appended": ("own", 'lamp = ["lit"] } }\n\n', 'lamp = ["red"] } }\n\n', "unknown_state", "own", "red"),
    "property replaced": (
        "own",
        'door = ["open"], lamp = ["lit"]',
        'door = ["gone"], lamp = ["lit"]',
        "unknown_state",
        "own",
        "gone",
    ),
    "property below": ("base", 'power = ["on"] } }\n', 'power = ["up"] } }\n', "unknown_state", "base", '"up"'),
    "property below that only the own file breaks": (
        "own",
        'title = "Open it"',
        'requires = { power = ["on", "off"] }',
        "property_violated",
        "base",
        'id = "powered"',
    ),
    "not TOML below": ("base", 'id = "base"', "id = base", "not_toml", "base", "id = base"),
    "hash below": ("base", 'id = "base"', 'id = "base"\nhash = "0"', "bad_value", "base", "hash ="),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_findings_point_to_the_file_and_line_the_key_came_from(folder: Path, fault: str) -> None:
    which, old, new, code, where, line = FAULTS[fault]
    texts = {"base": BASE, "own": OWN}
    assert texts[which].count(old) == 1
    texts[which] = texts[which].replace(old, new)
    (folder / "base.toml").write_text(texts["base"])
    finding = only(texts["own"], folder)
    assert (finding.code, finding.file) == (code, f"folder/{where}.toml")
    pointed = texts[where].split("\n")[max(finding.line - 2, 0) : finding.line + 1]
    assert any(line in each for each in pointed)


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ('"../base.toml"', "without a folder"),
        ('"/etc/base.toml"', "without a folder"),
        ("'sub\\base.toml'", "without a folder"),
        ('"."', "without a folder"),
        ('""', "without a folder"),
        ('"base"', ".toml"),
        ('".hidden.toml"', "without a folder"),
        ('"base.toml\\u0000"', "without a folder"),
        ("7", "without a folder"),
        ('["base.toml"]', "without a folder"),
        ('"absent.toml"', "there is no such file"),
        ('"sub.toml"', "there is no such file"),
        ('"own.toml"', "extends another file itself"),
    ],
)
def test_only_a_file_beside_it_that_stands_alone_can_be_extended(folder: Path, name: str, word: str) -> None:
    (folder / "sub.toml").mkdir()
    finding = only(OWN.replace('"base.toml"', name), folder)
    assert (finding.code, finding.path, finding.line) == ("bad_extends", ("extends",), 2)
    assert word in finding.text


def test_text_without_a_folder_extends_nothing(folder: Path) -> None:
    with pytest.raises(BlueprintError, match="has no folder") as refused:
        parse_blueprint(OWN.encode())
    assert [finding.code for finding in refused.value.fields["findings"]] == ["bad_extends"]
    assert parse_blueprint(OWN.encode(), folder=folder).id == "own"


def test_the_file_below_is_read_within_the_same_bounds(folder: Path) -> None:
    (folder / "base.toml").write_bytes(b"#" * (MAX_BYTES + 1))
    assert (only(OWN, folder).code, only(OWN, folder).file) == ("too_large", "folder/base.toml")
    (folder / "base.toml").write_bytes(b"a." * 100_000 + b"b = 1")
    assert only(OWN, folder).code == "too_deep"
    (folder / "base.toml").write_bytes(b"id = '\xff'")
    assert only(OWN, folder).code == "not_utf8"


@examples(60)
@given(at=st.integers(0, len(BASE) - 1), length=st.integers(0, 60), put=st.binary(max_size=20))
def test_any_damage_below_ends_in_findings_with_a_place(
    tmp_path_factory: pytest.TempPathFactory, at: int, length: int, put: bytes
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    (folder / "base.toml").write_bytes(BASE.encode()[:at] + put + BASE.encode()[at + length :])
    for finding in examine(OWN.encode(), origin="own.toml", folder=folder, limit=100).findings:
        assert finding.text
        assert finding.file in ("own.toml", "base.toml")
        assert finding.line >= 1


COMMANDS = {
    "verify": ["verify"],
    "generate": ["generate"],
    "render": ["render"],
    "scxml": ["export", "--format", "scxml"],
    "promela": ["export", "--format", "promela"],
    "table": ["export", "--format", "table"],
    "test": ["test"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_on_a_blueprint_takes_it(folder: Path, command: str) -> None:
    result = CliRunner().invoke(main, ["fsm", *COMMANDS[command], str(folder / "own.toml")])
    assert result.exit_code == 0, result.output
    assert result.stdout


def test_it_can_be_compared_and_stepped_through(folder: Path) -> None:
    files = [str(folder / "base.toml"), str(folder / "own.toml")]
    assert "lamp" in CliRunner().invoke(main, ["fsm", "diff", *files]).stdout
    walked = CliRunner().invoke(main, ["fsm", "simulate", "--random", "20", "--seed", "1", files[1]])
    assert walked.exit_code == 0, walked.output
    unfolded = CliRunner().invoke(main, ["fsm", "verify", "-"], input=OWN)
    assert unfolded.exit_code == 5
    assert "<stdin>:2:1: bad_extends" in unfolded.stdout


def test_the_shipped_grid_mapping_is_ratms_and_its_own() -> None:
    """What extends ratms.toml says all else as ratms.toml does."""
    ratms, grid = shipped_blueprint("ratms"), shipped_blueprint("grid_mapping")
    assert {name: branch for name, branch in grid.branches.items() if name not in ("mapping", "toolplan")} == {
        name: branch for name, branch in ratms.branches.items() if name != "toolplan"
    }


def test_each_layer_of_an_extended_file_may_have_its_own_names(tmp_path: Path) -> None:
    (tmp_path / "pump.toml").write_text(PUMP % "acts = true")
    (tmp_path / "slow.toml").write_text(
        'extends = "pump.toml"\nid = "slow"\nversion = "1"\n'
        "[branches.pump.operations.start]\naffects_patient = true\ntimeout_s = 60\n"
    )
    warned: list[str] = []
    blueprint = load_blueprint(tmp_path / "slow.toml", warn=lambda warning: warned.append(warning.file))
    assert blueprint.branches["pump"].operations["start"].affects_patient
    assert warned == [str(tmp_path / "pump.toml")]
