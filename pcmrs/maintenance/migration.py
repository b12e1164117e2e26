"""Whether the present blueprint of a workflow may continue a journal that an older one wrote."""

from __future__ import annotations

from pathlib import Path

import tomli_w

from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint
from pcmrs.fsm.blueprint import MigrationSpec
from pcmrs.journal import JournalReader
from pcmrs.messages import BlueprintTag


def migration_for(journal: JournalReader, blueprint: Blueprint, file: Path) -> MigrationSpec | None:
    """Return the declared migration from the journal's blueprint to the present one; None if none is needed.

    Args:
        journal: Journal of the cell.
        blueprint: The workflow that will write it.
        file: File of the workflow, for the message.

    Raises:
        ConfigurationError: The journal is of another blueprint, and the present one declares no migration from it;
            the message has the table that does.
    """
    last = last_blueprint(journal)
    if last is None or (last.version, last.hash) == (blueprint.version, blueprint.hash):
        return None
    for known in blueprint.migrations:
        if (known.version, known.hash) == (last.version, last.hash):
            return known
    text = (
        f"{journal.path} was last written under {_named(last)}, and {file} is now {_named(blueprint)}. "
        f"Review the change with `pcmrs fsm diff OLD {file}`; then add to {file}:\n\n{_migration(last)}\n"
        "or start with another cell.folder."
    )
    raise ConfigurationError(text, journal=str(journal.path), version=last.version, hash=last.hash)


def last_blueprint(journal: JournalReader) -> BlueprintTag | None:
    """Return the blueprint of the last row; None if the journal has no rows."""
    return next((stored.row.blueprint for stored in journal.read(last=1)), None)


def _named(of: BlueprintTag | Blueprint) -> str:
    return f"{of.id} {of.version} (hash {of.hash})"


def _migration(last: BlueprintTag) -> str:
    table = {"version": last.version, "hash": last.hash, "why": "what makes it safe"}
    return tomli_w.dumps({"migrations": [table]})
