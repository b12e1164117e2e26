"""Archive: the journals of many cells in one place, for questions about all of them."""

from pcmrs.archive._adding import AddedRows, add_journal, find_journals
from pcmrs.archive._opening import open_store
from pcmrs.archive._questions import QUESTIONS, Question
from pcmrs.archive._store import ArchivedJournal, ArchiveStore
from pcmrs.archive._verification import ArchiveVerification, verify_archive

__all__ = [
    "QUESTIONS",
    "AddedRows",
    "ArchiveStore",
    "ArchiveVerification",
    "ArchivedJournal",
    "Question",
    "add_journal",
    "find_journals",
    "open_store",
    "verify_archive",
]
