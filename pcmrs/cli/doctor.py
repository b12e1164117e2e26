"""`pcmrs doctor`: checks that this machine has what a cell needs, with remedies."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.box import SIMPLE_HEAD
from rich.table import Table

from pcmrs.cli.options import config_options, json_option
from pcmrs.cli.running import EXIT_FAILED, EXIT_REJECTED, readable_errors
from pcmrs.cli.tables import print_report, styled

if TYPE_CHECKING:
    from pcmrs.doctor import Examination

STATUS = {"good": 0, "warning": EXIT_REJECTED, "bad": EXIT_FAILED}
COLOURS = {"good": "green", "warning": "yellow", "bad": "red"}


@click.command()
@json_option
@config_options
@readable_errors
def doctor(as_json: bool, file: Path | None, overrides: tuple[str, ...]) -> None:
    """Check that this machine has what the configured cell needs, without changing anything.

    Scheduling, kernel, limits, clock source, fsync time and free space of the disk, ports, extras, devices and
    certificates. Run it as the user, and in the service or container, that runs the daemon: they set the limits.

    Exit status: 0 all good, 1 it works, with warnings, 5 something is bad, 4 the configuration cannot be used.
    """
    from pcmrs.doctor import examine
    from pcmrs.settings import read_settings

    found = examine(read_settings(file, overrides))
    print_report(found, _table(found), as_json=as_json)
    sys.exit(STATUS[found.verdict])


def _table(found: Examination) -> Table:
    """Return one row for each finding; below one that is not good, what to do."""
    table = Table(box=SIMPLE_HEAD)
    for name in ("check", "verdict"):
        table.add_column(name, no_wrap=True)
    table.add_column("found", overflow="fold")
    for finding in found.findings:
        text = styled(finding.found, *([f"→ {finding.remedy}"] if finding.remedy else []))
        table.add_row(finding.check, styled(finding.verdict, style=COLOURS[finding.verdict]), text)
    return table
