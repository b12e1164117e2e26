"""How a calibration ends: shown, drawn, written where it is good enough, and with its exit status."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import click
from rich.box import SIMPLE_HEAD
from rich.table import Table

from pcmrs.calibration import next_version, write_calibration
from pcmrs.cli.calibrate.options import About, Asked
from pcmrs.cli.calibrate.solved import Solved, draw_residuals
from pcmrs.cli.printing import Terminal, say
from pcmrs.cli.running import EXIT_REJECTED
from pcmrs.errors import DegenerateMotionError, RefusalError

MOST_ROWS = 200
"""More poses than this are not listed one by one."""


def conclude(asked: Asked, solve: Callable[[], Solved]) -> None:
    """Solve, and ends the command: exit status 0 usable, 1 refused."""
    try:
        solved = solve()
    except (DegenerateMotionError, RefusalError) as error:
        _end_refused(asked, error, {})
    if asked.plot is not None:
        draw_residuals(solved, asked.plot)
    try:
        solved.check_limits()
    except RefusalError as error:
        if not asked.as_json:
            _show(solved)
        _end_refused(asked, error, solved.values)
    written = _write(asked.about, asked.about.output, solved) if asked.about.output is not None else {}
    if asked.as_json:
        say(json.dumps({"accepted": True, "reason": None, **solved.values, **written}))
        return
    _show(solved)
    if written:
        say(f"written: {written['file']}, version {written['version']}")


def _write(about: About, output: Path, solved: Solved) -> dict[str, Any]:
    version = next_version(output, solved.kind, about.name or solved.kind, about.serial)
    written = write_calibration(output, solved.as_calibration(about, version))
    return {"file": str(output), "version": written.version, "sha256": written.sha256}


def _end_refused(asked: Asked, error: DegenerateMotionError | RefusalError, values: dict[str, Any]) -> NoReturn:
    code = error.refusal_code if isinstance(error, RefusalError) else error.code
    if asked.as_json:
        reason = {"code": code, "text": error.text, "fields": error.fields}
        say(json.dumps({"accepted": False, "reason": reason, **values}))
    say(f"{click.get_current_context().command_path}: {error.text}", err=True)
    sys.exit(EXIT_REJECTED)


def _show(solved: Solved) -> None:
    for line in solved.summary:
        say(line)
    count = len(solved.residuals["mm"])
    over = ", ".join(f"{value:.3f} {unit} (limit {solved.limits[unit]:g})" for unit, value in solved.rms.items())
    say(f"rms residual {over} over {count - len(solved.bad)} of {count} poses")
    if solved.bad:
        bad = ", ".join(str(index + 1) for index in solved.bad)
        say(f"left out, since they do not fit the others: pose {bad}")
    if count <= MOST_ROWS:
        Terminal().print(_table(solved))


def _table(solved: Solved) -> Table:
    table = Table("pose", *solved.residuals, "", box=SIMPLE_HEAD, title="residuals", title_justify="left")
    for index, row in enumerate(zip(*solved.residuals.values(), strict=True)):
        table.add_row(str(index + 1), *(f"{value:.3f}" for value in row), "bad" if index in solved.bad else "")
    return table
