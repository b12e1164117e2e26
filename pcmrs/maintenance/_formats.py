"""Format of each file that a cell keeps, and what this version does with it: use it, upgrade it, or refuse it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Final, Literal

from pcmrs.errors import BlueprintError, ConfigurationError, FileFormatError, JournalError, PcmrsError
from pcmrs.fsm import Blueprint, load_blueprint
from pcmrs.gateway.auth.counters import check_counters
from pcmrs.journal import JournalReader, verify
from pcmrs.journal.schema import VERSION
from pcmrs.journal.verification import Progress
from pcmrs.maintenance._folder import FORMAT, JOURNALS, later_format, not_a_cell, read_format
from pcmrs.maintenance.migration import last_blueprint, migration_for
from pcmrs.messages import Message
from pcmrs.workflows.find import find_installed, find_workflow

Action = Literal["use", "upgrade", "refuse"]
"""What this version does with a file: it uses the file as it is, `pcmrs upgrade` changes its format, or neither."""

COUNTERS: Final = "peers.counters"
RECORDINGS: Final = "recordings"


class FileFormat(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Format of one file.

    Attributes:
        file: Path of the file.
        kind: Kind of the file, such as ``journal``.
        format: Its version; 0 if it is unknown.
        newest: Version that this program writes.
        action: What this program does with it.
        text: Reason, and what to do; empty if there is nothing to say.
    """

    file: str
    kind: str
    format: int
    newest: int
    action: Action
    text: str = ""


class FolderCheck(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What this version does with a cell's folder.

    Attributes:
        folder: Path of the folder.
        files: Its files with a format.
    """

    folder: str
    files: tuple[FileFormat, ...]

    @property
    def action(self) -> Action:
        """What happens to the whole folder: one refused file refuses it, one old file makes an upgrade necessary."""
        found = {file.action for file in self.files}
        return "refuse" if "refuse" in found else "upgrade" if "upgrade" in found else "use"

    @property
    def refused(self) -> tuple[FileFormat, ...]:
        """Files that this version refuses."""
        return tuple(file for file in self.files if file.action == "refuse")


def check_folder(folder: Path, workflow: str | None = None, progress: Progress | None = None) -> FolderCheck:
    """Read the formats of all files in a cell's folder, and verify its journals, without changing anything.

    Args:
        folder: Folder of a cell. A daemon may be running.
        workflow: Configured workflow: its name, or the path of its blueprint. None for the installed workflows.
        progress: Callback for the number of rows read.

    Raises:
        ConfigurationError: There is no such workflow.
        BlueprintError: The blueprint of the workflow is unsound.
        OSError: The folder cannot be read.
    """
    files = [_folder_format(folder)]
    blueprints = _Blueprints(workflow)
    files += [_journal_format(path, blueprints, progress) for path in sorted(folder.glob(JOURNALS))]
    if (counters := folder / COUNTERS).exists():
        files.append(_checked(counters, "counters of signed peers", check_counters))
    files += [_recording_format(path) for path in sorted((folder / RECORDINGS).glob("*.mcap"))]
    return FolderCheck(folder=str(folder), files=tuple(files))


def check_named_files(files: Iterable[tuple[str, Path, Callable[[Path], object]]]) -> Iterator[FileFormat]:
    """Yield the formats of files outside the folder, which the configuration names.

    Args:
        files: Kind and path of each file, and the function that reads it and raises `PcmrsError` for another format.
    """
    for kind, path, read in files:
        yield _checked(path, kind, read)


def _checked(path: Path, kind: str, read: Callable[[Path], object]) -> FileFormat:
    """Return the format of a file of which there is one version only: that, or a refusal."""
    newest = 1
    try:
        read(path)
    except PcmrsError as error:
        return FileFormat(file=str(path), kind=kind, format=0, newest=newest, action="refuse", text=error.text)
    return FileFormat(file=str(path), kind=kind, format=newest, newest=newest, action="use")


def _folder_format(folder: Path) -> FileFormat:
    try:
        found, text = read_format(folder).format, later_format(folder)
    except ConfigurationError as error:
        found, text = 0, error.text
    if other := not_a_cell(folder):
        found, text = 0, other
    action: Action = "refuse" if text else "upgrade" if found < FORMAT else "use"
    return FileFormat(file=str(folder), kind="folder of a cell", format=found, newest=FORMAT, action=action, text=text)


def _journal_format(path: Path, blueprints: _Blueprints, progress: Progress | None) -> FileFormat:
    action: Action = "refuse"
    found, text = 0, ""
    try:
        verified = verify(path, progress=progress)
        found = verified.version
        if verified.problems:
            text = " ".join(verified.problems)
        elif found < VERSION and verified.unnamed:
            text = _left_by_crash(path, verified.unnamed, found)
        else:
            blueprints.check(path)
            action = "upgrade" if found < VERSION else "use"
    except (JournalError, ConfigurationError, BlueprintError) as error:
        text = error.text
    return FileFormat(file=str(path), kind="journal", format=found, newest=VERSION, action=action, text=text)


def _left_by_crash(path: Path, unnamed: int, found: int) -> str:
    return (
        f"{path} has {unnamed} rows after the last one that its signed head names. Rows of format {found} have no MAC, "
        "so it is unknown whether a crash left them there or someone added them. Start the version of PCMRS that wrote "
        "them once, which adopts rows of a crash, and end it with SIGTERM."
    )


class _Blueprints:
    """Blueprints that may continue journals.

    Args:
        workflow: See `check_folder`.
    """

    def __init__(self, workflow: str | None) -> None:
        self._own: tuple[Blueprint, Path] | None = None
        if workflow is not None:
            file = find_workflow(workflow).blueprint
            self._own = load_blueprint(file), file

    def check(self, path: Path) -> None:
        """Require that the blueprint of a journal's workflow may continue it.

        A workflow that is neither configured nor installed is not checked: only its daemon knows its file.

        Raises:
            ConfigurationError: The journal is of another blueprint, and the present one declares no migration from it.
            BlueprintError: The installed blueprint is unsound.
            JournalError: The journal cannot be read.
        """
        with JournalReader(path) as journal:
            last = last_blueprint(journal)
            found = None if last is None else self._find(last.id)
            if found is not None:
                migration_for(journal, *found)

    def _find(self, workflow: str) -> tuple[Blueprint, Path] | None:
        if self._own is not None and self._own[0].id == workflow:
            return self._own
        try:
            file = find_installed(workflow).blueprint
        except ConfigurationError:
            return None
        return load_blueprint(file), file


def _recording_format(path: Path) -> FileFormat:
    from pcmrs.recording.file import FORMAT as NEWEST  # an extra, which a machine without recordings need not have
    from pcmrs.recording.reader import check_format, recording_format

    found, text = 0, ""
    try:
        found = recording_format(path) or 0
        check_format(path)
        if not found:
            text = f"{path} was cut before its first message."
    except FileFormatError as error:
        text = error.text
    # No daemon reads a recording, so none is a reason to refuse the folder.
    return FileFormat(file=str(path), kind="recording", format=found, newest=NEWEST, action="use", text=text)
