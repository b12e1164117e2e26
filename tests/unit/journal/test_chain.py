"""The chain through a journal that was edited by somebody who knows its format: the first bad row is reported."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, verify
from pcmrs.journal.chain import mac_key, row_mac, stored_row
from pcmrs.journal.keys import signing_key
from pcmrs.journal.rows import chain_hash, encode_row
from pcmrs.testing.journal import append_without_key
from tests.unit.journal.edited_journal import check_refused, edit, macs, make_index
from tests.unit.journal.journal_rows import row


def check_told(path: Path, sequence: int, word: str) -> None:
    with pytest.raises(JournalError, match=f"row {sequence} {word}"):
        Journal.open(path)
    found = verify(path)
    assert (found.first_bad, found.rows, found.sound) == (sequence, sequence - 1, False)


def test_row_replaced_with_its_own_hash_breaks_the_chain(whole_path: Path) -> None:
    with JournalReader(whole_path) as reader:
        rows = list(reader.read())
    ninth = rows[8]
    assert (ninth.sequence, ninth.row.kind) == (9, "event")
    body = encode_row(rows[5].row)  # the event of another command: right in itself, at the wrong place
    own = chain_hash(ninth.previous_hash, 9, body)
    edit(whole_path, "UPDATE journal SET body = ?, hash = ? WHERE sequence = 9", (body, own))
    check_told(whole_path, 10, "does not follow")


@pytest.mark.parametrize("change", ["branch = 'placement'", "wall = 0.0", "source = 'else'"])
@pytest.mark.parametrize("sequence", [9, 10])
def test_row_entered_under_other_keys_is_detected(whole_path: Path, change: str, sequence: int) -> None:
    edit(whole_path, f"UPDATE journal SET {change} WHERE sequence = {sequence}")
    check_told(whole_path, sequence, "is stored under wrong keys")


@pytest.mark.parametrize(("kind", "sequence"), [("intent", 7), ("outcome", 8)])
def test_row_missing_in_its_index_is_detected(whole_path: Path, kind: str, sequence: int) -> None:
    """A repeat of its command would run a second time."""
    make_index(whole_path, f"one_{kind}", f"AND sequence <> {sequence}")
    check_told(whole_path, sequence, "is not found by its command")


@pytest.mark.parametrize(
    "record", [(0, b"", b"", b""), ("1", b"", b"", b""), (1, None, b"", b""), (1, b"", "text", b""), (1, b"", b"", 5)]
)
def test_record_with_wrong_types_is_an_error(record: tuple[Any, ...]) -> None:
    """As a damaged page may have it, whatever the table allows."""
    with pytest.raises(JournalError, match="does not have the content of a row"):
        stored_row(Path("journal.sqlite"), record)


def test_a_mac_of_another_row_or_of_another_key_is_none(whole_path: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    own, other = (mac_key(signing_key(folder, make=True)) for folder in (whole_path.parent, tmp_path / "other"))
    append_without_key(whole_path, [row()], mac=macs(whole_path)[-1])
    check_refused(whole_path, 19, "It was written without the key")
    with JournalReader(whole_path) as reader:
        (added,) = reader.read(last=1)
    assert len({row_mac(own, added.hash), row_mac(other, added.hash), macs(whole_path)[-1]}) == 3
