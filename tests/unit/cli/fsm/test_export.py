"""`pcmrs fsm export` from the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.authoring.exchange.exporting.schema import schema
from tests.unit.cli.fsm.ring_chart import RING, run


@pytest.mark.parametrize(("form", "begins"), [("scxml", "<scxml "), ("promela", "/* "), ("table", "# Ring")])
def test_export(tmp_path: Path, form: str, begins: str) -> None:
    blueprint, written = tmp_path / "ring.toml", tmp_path / "ring.out"
    assert run("import", "-", "-o", str(blueprint), given=RING).exit_code == 0
    blueprint.write_text('title = "Ring"\n' + blueprint.read_text())
    shown = run("export", str(blueprint), "--format", form)
    assert (shown.exit_code, shown.stdout[: len(begins)]) == (0, begins)
    assert run("export", str(blueprint), "--format", form, "--output", str(written)).exit_code == 0
    assert written.read_text() == shown.stdout


def test_the_schema_needs_no_file() -> None:
    assert run("export", "--format", "json-schema").stdout == schema()
    refused = run("export", "--format", "table")
    assert refused.exit_code == 2
    assert "needs a FILE" in refused.stderr


def test_an_unreadable_and_an_unsound_file_are_not_exported(tmp_path: Path) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text("id = 1\n")
    assert run("export", str(bad), "--format", "scxml").exit_code == 5
    bad.write_text('id = "x"\nversion = "1"\n[branches.a]\nlevel = 3\nstates = { a = "" }\n')
    result = run("export", str(bad), "--format", "scxml")
    assert (result.exit_code, result.stdout) == (1, "")
    assert "bad_level" in result.stderr
