"""`pcmrs fsm import` from the command line."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

import pytest

from pcmrs.fsm import examine
from tests.unit.authoring.exchange.random_charts import as_drawio, as_mermaid, as_scxml, random_chart
from tests.unit.cli.fsm.ring_chart import RING, run


def test_import_writes_a_sound_blueprint(tmp_path: Path) -> None:
    chart, written = tmp_path / "ring.scxml", tmp_path / "ring.toml"
    chart.write_text(RING)
    result = run("import", str(chart), "-o", str(written))
    assert (result.exit_code, result.output) == (0, "")
    examination = examine(written.read_bytes())
    assert examination.blueprint is not None
    assert examination.sound
    assert run("import", str(chart)).stdout == written.read_text()


def test_import_of_an_unsound_chart_writes_it_with_its_findings(tmp_path: Path) -> None:
    written = tmp_path / "ring.toml"
    result = run("import", "-", "-o", str(written), given=RING.replace("</scxml>", '<state id="c"/></scxml>'))
    assert result.exit_code == 1
    assert written.exists()
    assert f"{written}:" in result.stderr
    assert "unreachable_state" in result.stderr


def test_dead_end_is_found_although_an_inner_branch_can_reinit() -> None:
    chart = "stateDiagram-v2\n[*] --> a\na --> b : go\nstate a {\nc --> d : go\n}\n"
    result = run("import", "-", given=chart)
    assert result.exit_code == 1
    assert "<blueprint>" in result.stderr
    assert "deadlock" in result.stderr
    assert run("import", "-", given=f"{chart}b --> [*]\n").exit_code == 0


def test_import_of_an_unsupported_chart_writes_nothing(tmp_path: Path) -> None:
    written = tmp_path / "ring.toml"
    result = run("import", "-", "-o", str(written), given=RING.replace('event="go" ', 'cond="x" '))
    assert result.exit_code == 5
    assert not written.exists()
    assert "<stdin>:2:17: not_supported" in result.stderr


@pytest.mark.parametrize("suffix", ["scxml", "mmd", "drawio", "xml", "txt"])
def test_the_format_is_found_by_the_suffix_or_the_content(tmp_path: Path, suffix: str) -> None:
    chart = random_chart(Random(4), plain=True)
    written = {
        "scxml": as_scxml(chart),
        "mmd": as_mermaid(chart),
        "drawio": as_drawio(chart, compressed=True),
        "xml": as_drawio(chart, compressed=False),
        "txt": as_mermaid(chart),
    }
    path = tmp_path / f"chart.{suffix}"
    path.write_text(written[suffix])
    result = run("import", str(path))
    assert result.exit_code in (0, 1)
    first, _, rest = result.stdout.partition("\n")
    assert first == f"# Imported from chart.{suffix}."
    assert rest == run("import", "-", "--from", "scxml", given=as_scxml(chart)).stdout.partition("\n")[2]


def test_import_says_in_json_what_came_of_it(tmp_path: Path) -> None:
    written = tmp_path / "ring.toml"
    result = run("import", "-", "--json", given=RING)
    assert result.exit_code == 0
    assert json.loads(result.stdout) == {"file": "<stdin>", "readable": True, "sound": True, "findings": []}
    unsound = run(
        "import", "-", "--json", "-o", str(written), given=RING.replace("</scxml>", '<state id="c"/></scxml>')
    )
    said = json.loads(unsound.stdout)
    assert (unsound.exit_code, said["readable"], said["sound"]) == (1, True, False)
    assert {finding["file"] for finding in said["findings"]} == {str(written)}
    unreadable = run("import", "-", "--json", given="<svg/>")
    said = json.loads(unreadable.stdout)
    assert (unreadable.exit_code, said["readable"], said["findings"][0]["code"]) == (5, False, "not_scxml")
    assert run("import", "-", "--json", "-o", "-", given=RING).exit_code == 2


def test_a_blueprint_that_could_not_be_read_again_is_not_written(tmp_path: Path) -> None:
    written = tmp_path / "many.toml"
    events = " ".join(f"e{number}" for number in range(5_000))
    result = run("import", "-", "-o", str(written), given=RING.replace('"go"', f'"{events}"', 1))
    assert result.exit_code == 5
    assert result.stderr.startswith("<stdin>:1:1: too_large: The blueprint of this chart would have ")
    assert not written.exists()
