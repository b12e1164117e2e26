"""A copy of a journal has the head that belongs to it, or is not made."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import copy_journal, export, verify
from pcmrs.journal.head import read_head
from pcmrs.journal.keys import signing_key
from pcmrs.journal.rows import encode_row
from pcmrs.journal.writer import JournalWriter
from pcmrs.testing.journal import HEAD, NAME, place
from tests.unit.journal.journal_rows import row
from tests.unit.journal.whole_journal import sample


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "whole").mkdir()
    (tmp_path / "copy").mkdir()
    return place(sample(tmp_path / "whole", killed=False).files, tmp_path / "cell")


def test_journal_without_its_head_is_not_copied_as_whole(path: Path, tmp_path: Path) -> None:
    path.with_name(HEAD).unlink()
    with pytest.raises(JournalError, match="head is missing"):
        copy_journal(path, tmp_path / "copy" / NAME)


def test_the_head_of_a_copy_names_its_last_row(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where a row was written after the head was read."""
    writer, copied = JournalWriter(path, durable=False), export._copy_database

    def copy_later(*paths: Path) -> Any:
        writer.write([(row(), encode_row(row()))])
        return copied(*paths)

    monkeypatch.setattr(export, "_copy_database", copy_later)
    copy_journal(path, tmp_path / "copy" / NAME)
    writer.close()
    found = verify(tmp_path / "copy" / NAME)
    assert (found.sound, found.rows, found.signed) == (True, 19, 19)


def test_signature_for_another_purpose_is_no_head(path: Path) -> None:
    key, head = signing_key(path.parent, make=False), path.with_name(HEAD)
    message = struct.pack(">8sQQ32s", b"PCMRSXX1", 1000, 3, bytes(32))
    content = bytearray(head.read_bytes())
    content[:120] = message + key.sign(message)
    head.write_bytes(content)
    state = read_head(head, key.public_key())
    assert state is not None
    assert state.damaged == 1
    assert state.head is not None
    assert state.head.counter < 1000
