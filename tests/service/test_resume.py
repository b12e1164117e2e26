"""A journal is taken up under the blueprint that wrote it, or under one that declares the migration."""

from __future__ import annotations

import tomllib
from collections.abc import AsyncIterator
from pathlib import Path

import msgspec
import pytest
from clock import ManualClock

from pcmrs.errors import ConfigurationError, JournalError
from pcmrs.fsm import Blueprint
from pcmrs.journal import Journal, JournalRow
from pcmrs.messages import BlueprintTag, DeviceEvent
from pcmrs.service.recorder import JournalRecorder
from pcmrs.service.resume import check_resumable
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


async def test_an_empty_journal_and_one_of_the_same_blueprint_are_taken_up(journal: Journal) -> None:
    check_resumable(journal.reader, OLD, FILE)
    await _write(journal, OLD)
    check_resumable(journal.reader, OLD, FILE)


@pytest.mark.parametrize(
    "other", [NEW, msgspec.structs.replace(OLD, hash="bb"), msgspec.structs.replace(OLD, version="2")]
)
async def test_another_version_or_content_is_refused_until_the_table_of_the_text_is_added(
    journal: Journal, other: Blueprint
) -> None:
    await _write(journal, OLD)
    with pytest.raises(ConfigurationError) as refused:
        check_resumable(journal.reader, other, FILE)
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
    check_resumable(journal.reader, migrated, FILE)


async def test_only_the_blueprint_that_wrote_last_counts(journal: Journal) -> None:
    await _write(journal, OLD)
    await _write(journal, NEW)
    check_resumable(journal.reader, NEW, FILE)
    with pytest.raises(ConfigurationError):
        check_resumable(journal.reader, OLD, FILE)


async def test_what_an_older_program_left_in_other_types_is_told_with_the_file(journal: Journal) -> None:
    tag = BlueprintTag(id="lamp", version="1", hash="aa")
    row = JournalRow(
        kind="outcome", wall=0.0, monotonic=0.0, boot_id="b", session_id="s", blueprint=tag,
        branch="registration", result={"previous": {"id": 5}},
    )  # fmt: skip
    await journal.append([row])
    with pytest.raises(JournalError, match=r"lamp\.sqlite.*cell\.folder"):
        JournalRecorder(journal, ManualClock(), "s2", tag).previous(PlacementData())
