"""Source of a report: an exported session, a cell's folder, or a journal, read up to its first bad row."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from pcmrs.errors import JournalError
from pcmrs.files import sha256_of
from pcmrs.journal import JournalReader, StoredRow, journal_files, verify
from pcmrs.journal.head import head_path
from pcmrs.journal.keys import PUBLIC
from pcmrs.recording.series import SUFFIX, session_files
from pcmrs.recording.settings import FOLDER
from pcmrs.report._contents import ReportedFile, ReportedJournal
from pcmrs.report.session_export import README
from pcmrs.report.session_folder import JOURNAL, SUMS

__all__ = ["ReportSource", "open_source"]

MAGIC = b"\x89MCAP0\r\n"
"""Last bytes of a recording that was ended in order."""


@dataclass(frozen=True, slots=True)
class ReportSource:
    """A verified journal; the session's other files are beside it.

    Attributes:
        path: Journal file.
        rows: Good rows, from the first on.
        journal: Result of the verification.
        exported: Id of the exported session; None if the folder is not an export.
    """

    path: Path
    rows: tuple[StoredRow, ...]
    journal: ReportedJournal
    exported: str | None


def open_source(path: Path) -> ReportSource:
    """Read and verify a journal; a damaged one is read up to its first bad row.

    Args:
        path: Folder of an exported session, folder of a cell with one journal, or journal file.

    Raises:
        JournalError: There is no journal, more than one, or none of its rows can be read.
    """
    found = _journal_in(path) if path.is_dir() else path
    if not found.is_file():
        raise JournalError(f"There is no journal {found}.", path=str(found))
    rows, problems = _good_rows(found)
    signature, proven = "does not hold", 0
    try:
        verification = verify(found)
    except JournalError as error:  # its key is missing
        problems.append(error.text)
    else:
        problems = list(verification.problems) or problems
        signature, proven = verification.signature, verification.signed
    if not rows:
        reason = " ".join(problems) or "It is empty."
        raise JournalError(f"No row of {found} can be read, so there is nothing to report. {reason}", path=str(found))
    key = found.parent / PUBLIC
    journal = ReportedJournal(
        name=found.name,
        rows=len(rows),
        # Without the folder, since the report of a copy elsewhere must have the same bytes.
        problems=tuple(problem.replace(f"{found.parent}/", "") for problem in problems),
        signature=signature,
        proven=proven,
        last_hash=rows[-1].hash.hex(),
        key=sha256_of(key).hex() if key.is_file() else "",
    )
    return ReportSource(found, tuple(rows), journal, _exported(path) if path.is_dir() else None)


def files_of(
    source: ReportSource, sessions: Sequence[str], calibrations: Mapping[str, str]
) -> tuple[ReportedFile, ...]:
    """Return journal, recordings and calibration files with their hashes.

    Args:
        source: Source of the report.
        sessions: Ids of the sessions whose recordings are listed.
        calibrations: Kind to the path in the configuration.
    """
    folder = source.path.parent
    if source.exported is not None:
        return tuple(_listed(folder))
    beside = [*journal_files(source.path), head_path(source.path), folder / PUBLIC]
    recordings = session_files(folder / FOLDER, sessions)
    found = [_file(path.relative_to(folder).as_posix(), path) for path in (*beside, *recordings) if path.is_file()]
    for kind, path in calibrations.items():
        name = f"calibration of the {kind}: {Path(path).name}"
        here = Path(path).is_file()
        found.append(
            _file(name, Path(path))
            if here
            else ReportedFile(name=name, size=0, sha256="", note="is not there any more")
        )
    return tuple(found)


def _journal_in(folder: Path) -> Path:
    if (folder / JOURNAL).is_file():
        return folder / JOURNAL
    journals = sorted(folder.glob("*.sqlite"))
    if len(journals) == 1:
        return journals[0]
    reason = "More than one journal is" if journals else "There is no journal"
    names = f": {', '.join(path.name for path in journals)}; name one" if journals else ""
    raise JournalError(f"{reason} in {folder}{names}.", path=str(folder))


def _good_rows(path: Path) -> tuple[list[StoredRow], list[str]]:
    rows: list[StoredRow] = []
    try:
        with JournalReader(path) as reader:
            rows.extend(reader.read_whole())
    except JournalError as error:
        return rows, [error.text]
    return rows, []


def _exported(folder: Path) -> str | None:
    """Return the id of the session in an export; None if the folder is not an export."""
    with suppress(OSError, UnicodeDecodeError):
        if match := re.match(r"Session (\S+) of a cell", (folder / README).read_text(encoding="utf-8")):
            return match[1]
    return None


def _listed(folder: Path) -> Iterator[ReportedFile]:
    """Yield the files of an export, each compared with the hash in its list."""
    listed = {}
    with suppress(OSError, UnicodeDecodeError):
        lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
        listed = {name: digest for digest, _, name in (line.partition("  ") for line in lines)}
    needed = (JOURNAL, head_path(Path(JOURNAL)).name, PUBLIC)
    for name in dict.fromkeys((*needed, *listed)):
        path = folder / name
        if not path.is_file():
            yield ReportedFile(name=name, size=0, sha256="", note="is not there", wrong=True)
            continue
        file = _file(name, path)
        if name not in listed:
            file = msgspec.structs.replace(file, note=f"is not in {SUMS}", wrong=True)
        elif file.sha256 != listed[name]:
            file = msgspec.structs.replace(file, note=f"differs from {SUMS}", wrong=True)
        yield file


def _file(name: str, path: Path) -> ReportedFile:
    cut = path.suffix == SUFFIX and not _is_ended(path)
    note = "was not ended: its last second may be missing" if cut else ""
    return ReportedFile(name=name, size=path.stat().st_size, sha256=sha256_of(path).hex(), note=note)


def _is_ended(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - len(MAGIC)))
        return file.read() == MAGIC
