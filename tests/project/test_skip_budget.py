"""With all tools installed a skip beyond the budget fails the run and is named. The suite needs no Ctrl-C either."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests import ROOT
from tests.support.skip_budget import BUDGET

CONFTEST = """
from pathlib import Path
from tests.support.skip_budget import SkipBudget
def pytest_configure(config):
    config.pluginmanager.register(SkipBudget(Path(__file__).with_name("skips.toml")))
"""
SKIPPED = """
import pytest
def test_passes(): pass
@pytest.mark.xfail
def test_is_known_to_fail(): assert False
@pytest.mark.parametrize("number", range({often}))
def test_is_allowed(number): pytest.skip("no priority")
"""
ALLOWED = "[[skip]]\nreason = 'no prior.*'\nwhy = 'x'\nmost = 2\n"


def run_pytest(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "skips.toml").write_text(ALLOWED)
    (tmp_path / "test_few.py").write_text(SKIPPED.format(often=2))
    return tmp_path


def test_skips_within_the_budget_fail_nothing(suite: Path) -> None:
    ended = run_pytest(cwd=suite)

    assert ended.returncode == 0, ended.stdout
    assert "beyond" not in ended.stdout


def test_skips_beyond_the_budget_fail_a_run_in_several_processes(suite: Path) -> None:
    (suite / "test_few.py").write_text(SKIPPED.format(often=3))
    (suite / "test_spin.py").write_text("import pytest\ndef test_proof(): pytest.skip('no spin')")
    (suite / "test_none.py").write_text("import pytest\npytest.importorskip('no_such_module')")

    ended = run_pytest("-n", "2", cwd=suite)

    assert ended.returncode == 1, ended.stdout
    named = re.findall(r"^(test_\w+\.py\S*): (no spin|no priority|could not import)", ended.stdout, re.MULTILINE)
    assert [(file.partition("::")[0], why) for file, why in sorted(named)] == [
        ("test_few.py", "no priority"),
        ("test_none.py", "could not import"),
        ("test_spin.py", "no spin"),
    ]


def test_every_skip_of_the_budget_has_a_reason() -> None:
    for each in tomllib.loads(BUDGET.read_text())["skip"]:
        assert each.keys() == {"reason", "why", "most"}
        assert each["why"]
        assert re.compile(each["reason"])


def test_suite_ends_its_children_in_a_shell_that_ignores_ctrl_c() -> None:
    """As in a script that starts it with `&`."""
    test = "tests/unit/cli/test_journal.py::test_a_journal_can_be_followed_while_it_is_written"
    command = f"trap '' INT; exec {sys.executable} -m pytest -q -p no:cacheprovider {test}"
    ended = subprocess.run(["bash", "-c", command], cwd=ROOT, capture_output=True, text=True, check=False)

    assert ended.returncode == 0, ended.stdout
