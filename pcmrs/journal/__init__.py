"""The durable decision log: commands, decisions and device reports, in order and without gaps."""

from pcmrs.journal._journal import Journal
from pcmrs.journal.export import copy_journal
from pcmrs.journal.reader import JournalReader, journal_files
from pcmrs.journal.rows import JournalRow, Kind, StoredRow
from pcmrs.journal.verification import JournalVerification, verify

__all__ = [
    "Journal",
    "JournalReader",
    "JournalRow",
    "JournalVerification",
    "Kind",
    "StoredRow",
    "copy_journal",
    "journal_files",
    "verify",
]
