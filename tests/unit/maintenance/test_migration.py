"""A journal of another blueprint is continued only if the present blueprint declares that."""

from __future__ import annotations

import tomllib
from collections.abc import AsyncIterator
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint
from pcmrs.fsm.blueprint import MigrationSpec
from pcmrs.journal import Journal
from pcmrs.maintenance.migration import migration_for
from pcmrs.messages import BlueprintTag, DeviceEvent
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.testing.clock import ManualClock


@pytest.fixture
async def journal(tmp_path: Path) -> AsyncIterator[Journal]:
    journal = Journal.open(tmp_path / "lamp.sqlite", durable=False)
    yield journal
    await journal.close()


FILE = Path("my/lamp.toml")


OLD = Blueprint(id="lamp", version="1.0.0", branches={}, hash="aa")


NEW = Blueprint(id="lamp", version="1.1.0", branches={}, hash="bb")


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
    await JournalRecorder(journal, ManualClock(), "s2", tag).record_migration(used)
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


async def test_only_the_blueprint_that_wrote_last_counts(journal: Journal) -> None:
    await _write(journal, OLD)
    await _write(journal, NEW)
    assert migration_for(journal.reader, NEW, FILE) is None
    with pytest.raises(ConfigurationError):
        migration_for(journal.reader, OLD, FILE)
