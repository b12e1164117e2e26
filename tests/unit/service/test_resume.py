"""A journal is taken up under the blueprint that wrote it, or under one that declares the migration."""

from __future__ import annotations

import json
import tomllib
from collections.abc import AsyncIterator
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.errors import ConfigurationError, JournalError
from pcmrs.fsm import Blueprint
from pcmrs.fsm.blueprint import MigrationSpec
from pcmrs.fsm.files.load import read_blueprint
from pcmrs.journal import Journal, JournalRow
from pcmrs.messages import BlueprintTag, DeviceEvent, Verdict
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.service.restart.recovery import migration_for
from pcmrs.testing.clock import ManualClock
from pcmrs.workflows.data import PlacementData

FILE = Path("my/lamp.toml")
OLD = Blueprint(id="lamp", version="1.0.0", branches={}, hash="aa")
NEW = Blueprint(id="lamp", version="1.1.0", branches={}, hash="bb")


@pytest.fixture
async def journal(tmp_path: Path) -> AsyncIterator[Journal]:
    opened = Journal.open(tmp_path / "lamp.sqlite", durable=False)
    yield opened
    await opened.close()


async def _write(journal: Journal, blueprint: Blueprint) -> None:
    tag = BlueprintTag(id=blueprint.id, version=blueprint.version, hash=blueprint.hash)
    recorder = JournalRecorder(journal, ManualClock(), "s1", tag)
    await recorder.event(DeviceEvent(device="lamp", code="lit", text=""), {})


async def test_empty_journal_or_one_of_the_same_blueprint_is_resumed(journal: Journal) -> None:
    assert migration_for(journal.reader, OLD, FILE) is None
    await _write(journal, OLD)
    assert migration_for(journal.reader, OLD, FILE) is None


@pytest.mark.parametrize(
    "other", [NEW, msgspec.structs.replace(OLD, hash="bb"), msgspec.structs.replace(OLD, version="2")]
)
async def test_other_version_is_refused_until_the_table_is_added(journal: Journal, other: Blueprint) -> None:
    """The text of the refusal has the table. A version of other content is refused alike."""
    await _write(journal, OLD)
    with pytest.raises(ConfigurationError) as refused:
        migration_for(journal.reader, other, FILE)
    text = refused.value.text
    for word in (
        "1.0.0",
        other.version,
        "aa",
        other.hash,
        str(FILE),
        str(journal.reader.path),
        "fsm diff",
        "cell.folder",
    ):
        assert word in text
    (_, table, _) = text.split("\n\n")
    migrations = msgspec.convert(tomllib.loads(table), type=dict[str, list[dict[str, str]]])["migrations"]
    migrated = msgspec.convert(msgspec.to_builtins(other) | {"migrations": migrations}, Blueprint)
    used = migration_for(journal.reader, migrated, FILE)
    assert used is not None
    assert (used.version, used.hash, used.why) == ("1.0.0", "aa", "what makes it safe")


async def test_a_migration_that_is_used_is_in_the_journal_once(journal: Journal) -> None:
    await _write(journal, OLD)
    other = MigrationSpec(version="0.9", hash="99", why="never used")
    declared = MigrationSpec(version="1.0.0", hash="aa", why="only a deadline changed")
    migrated = msgspec.structs.replace(NEW, migrations=[other, declared])
    used = migration_for(journal.reader, migrated, FILE)
    assert used == declared
    tag = BlueprintTag(id=NEW.id, version=NEW.version, hash=NEW.hash)
    await JournalRecorder(journal, ManualClock(), "s2", tag).taken_up(used)
    shown = CliRunner().invoke(main, ["journal", "show", str(journal.reader.path), "--last", "1"])
    assert shown.exit_code == 0, shown.output
    assert "event" in shown.output
    assert "Taken up from 1.0.0 aa because only a deadline changed" in shown.output
    assert migration_for(journal.reader, migrated, FILE) is None, "it is written under the present blueprint now"


async def test_migration_from_other_content_of_the_version_is_refused(journal: Journal) -> None:
    await _write(journal, OLD)
    declared = MigrationSpec(version=OLD.version, hash="cc", why="only a deadline changed")
    with pytest.raises(ConfigurationError, match="migrations"):
        migration_for(journal.reader, msgspec.structs.replace(NEW, migrations=[declared]), FILE)


@pytest.mark.parametrize("why", ["", " ", "\n\t"])
def test_a_migration_must_say_why(why: str) -> None:
    text = f'id = "x"\nversion = "1"\nmigrations = [{{ version = "0", hash = "aa", why = {json.dumps(why)} }}]\n'
    text += 'branches.lamp = { states = { off = "dark" } }\n'
    blueprint, (finding,) = read_blueprint(text.encode(), "x.toml")
    assert blueprint is None
    assert (finding.code, finding.path) == ("bad_value", ("migrations", "0", "why"))


async def test_only_the_blueprint_that_wrote_last_counts(journal: Journal) -> None:
    await _write(journal, OLD)
    await _write(journal, NEW)
    assert migration_for(journal.reader, NEW, FILE) is None
    with pytest.raises(ConfigurationError):
        migration_for(journal.reader, OLD, FILE)


async def test_values_of_types_of_an_older_program_are_reported(journal: Journal) -> None:
    tag = BlueprintTag(id="lamp", version="1", hash="aa")
    row = JournalRow(
        kind="outcome", wall=0.0, monotonic=0.0, boot_id="b", session_id="s", blueprint=tag,
        branch="registration", operation="register", result={"previous": {"id": 5}},
        verdict=Verdict(id="c", branch="registration", operation="register", decision="accepted", state="", sequence=1),
    )  # fmt: skip
    await journal.append([row])
    recorder = JournalRecorder(journal, ManualClock(), "s2", tag)
    kept = recorder.read_back(NEW)
    with pytest.raises(JournalError, match=r"lamp\.sqlite.*cell\.folder"):
        recorder.previous(kept, PlacementData())
