"""Whether a journal may be taken up under the blueprint of today."""

from __future__ import annotations

from pathlib import Path

import tomli_w

from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint
from pcmrs.fsm.blueprint import MigrationSpec
from pcmrs.journal import JournalReader
from pcmrs.messages import BlueprintTag


def migration_for(journal: JournalReader, blueprint: Blueprint, file: Path) -> MigrationSpec | None:
    """The declared migration by which a journal of another blueprint is taken up; None where none is needed.

    Args:
        journal: Of the cell.
        blueprint: The workflow that is to write it.
        file: Where that was read from, for the text.

    Raises:
        ConfigurationError: The journal is of another blueprint, and the present one declares no migration from it;
            the text has the table that does.
    """
    last = next((stored.row.blueprint for stored in journal.read(last=1)), None)
    if last is None or (last.version, last.hash) == (blueprint.version, blueprint.hash):
        return None
    for known in blueprint.migrations:
        if (known.version, known.hash) == (last.version, last.hash):
            return known
    text = (
        f"{journal.path} was last written under {_named(last)}, and {file} is now {_named(blueprint)}. "
        f"Review the change with `pcmrs fsm diff OLD {file}`; then add to {file}:\n\n{_migration(last)}\n"
        "or begin anew in another cell.folder."
    )
    raise ConfigurationError(text, journal=str(journal.path), version=last.version, hash=last.hash)


def _named(of: BlueprintTag | Blueprint) -> str:
    return f"{of.id} {of.version} (hash {of.hash})"


def _migration(last: BlueprintTag) -> str:
    table = {"version": last.version, "hash": last.hash, "why": "what makes it safe"}
    return tomli_w.dumps({"migrations": [table]})
