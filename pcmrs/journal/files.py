"""The files of one journal: the first, and those in which it goes on once that has grown.

`ratms.sqlite` is followed by `ratms.sqlite.0002`. The first row of a later file continues the chain of hashes and names
the file before it. An earlier file is not written any more, and stays where it is: repeats of commands are found in it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from pcmrs.errors import JournalError

LARGEST: Final = 256e6
"""Size beyond which a journal goes on in a new file unless told otherwise, bytes: some 200,000 rows."""


def numbered(journal: Path, number: int) -> Path:
    """The file of a journal with this number, from 1."""
    return journal if number == 1 else journal.with_name(f"{journal.name}.{number:04d}")


def journal_files(journal: Path) -> list[Path]:
    """All files of a journal in their order; the first, `journal` itself, need not be there when it is the only one.

    Raises:
        JournalError: A file before the last one is missing.
    """
    later = {path for path in journal.parent.glob("*.[0-9][0-9][0-9][0-9]") if path.stem == journal.name}
    files = [numbered(journal, number) for number in range(1, len(later) + 2)]
    missing = [path for path in files[1:] if path not in later]
    if later and not journal.exists():
        missing.insert(0, journal)
    if missing:
        names = ", ".join(path.name for path in missing)
        text = f"{names} of the journal {journal} is missing, and later files are there: put it back from a copy."
        raise JournalError(text, path=str(missing[0]))
    return files
