"""`docs/timers.md`: its blueprint is that of the example, and each command prints what the page shows."""

from __future__ import annotations

import re
import tomllib

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.fsm.files.load import read_blueprint
from tests import ROOT

PAGE = (ROOT / "docs" / "timers.md").read_text()
EXAMPLE = ROOT / "examples" / "timed_pulses" / "timed_pulses.toml"
(VERIFIED, SIMULATED) = re.findall(r"^```console\n\$ (.*)\n((?:.*\n)*?)^```", PAGE, re.MULTILINE)


@pytest.fixture(autouse=True)
def _at_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def test_the_blueprint_of_the_page_is_part_of_the_example() -> None:
    (shown,) = re.findall(r"^```toml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    page, example = tomllib.loads(shown), tomllib.loads(EXAMPLE.read_text())
    limits = page["defaults"]["procedure"]["limits"]
    assert limits.items() <= example["defaults"]["procedure"]["limits"].items()
    placement = example["branches"]["placement"]
    assert page["branches"]["placement"]["timers"] == placement["timers"]
    assert page["branches"]["placement"]["operations"]["left_alone"] == placement["operations"]["left_alone"]


def test_the_example_is_verified_as_shown() -> None:
    command, shown = VERIFIED
    result = CliRunner().invoke(main, command.split()[1:])
    assert result.exit_code == 0, result.output
    assert result.output.startswith(shown.partition("…")[0])


def test_the_simulation_prints_what_is_shown() -> None:
    command, shown = SIMULATED
    lines = re.findall(r"printf '(.*?)'", command)[0].replace("\\n", "\n")
    result = CliRunner().invoke(main, ["fsm", "simulate", str(EXAMPLE.relative_to(ROOT))], input=lines)
    last = shown.splitlines()
    assert result.output.splitlines()[-len(last) :] == last


def test_each_state_of_a_timer_is_meant_in_the_table_of_the_page() -> None:
    blueprint, findings = read_blueprint(EXAMPLE.read_bytes(), "example")
    assert blueprint is not None, findings
    for branch in blueprint.branches.values():
        assert all(f"`{name}`" in PAGE for name in branch.timers)
