"""The base install and its extras: what it can do without them, and what its smallest part does not load."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Iterable

import pytest

from pcmrs.extras import EXTRAS, POSIX
from tests import ROOT

RATMS = ROOT / "pcmrs" / "workflows" / "ratms.toml"
HIDE = """
import sys, importlib.metadata
hidden = {hidden!r}
class Hide:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Hide)
for name in [each for each in sys.modules if each.partition(".")[0] in hidden]:
    del sys.modules[name]
whole = importlib.metadata.distributions
def distributions(**options):
    return (each for each in whole(**options) if each.name.replace("-", "_") not in hidden)
importlib.metadata.distributions = distributions
"""
"""Makes modules, and our distributions of these names, as good as not installed."""

OURS = ("pcmrs_sim", "pcmrs_lab")
BASE = HIDE.format(hidden={*OURS, *(module for modules in EXTRAS.values() for module in modules)})
WINDOWS = HIDE.format(hidden={*OURS, *POSIX, *(module for modules in EXTRAS.values() for module in modules)})
PACKAGES = {
    "coal": "coal", "duckdb": "duckdb", "evdev": "evdev", "fast-simplification": "fast_simplification",
    "foxglove-sdk": "foxglove", "httpx": "httpx", "jinja2": "jinja2", "matplotlib": "matplotlib", "mcap": "mcap",
    "ndicapi": "ndicapy", "nibabel": "nibabel", "nicegui": "nicegui", "pin": "pinocchio",
    "plutoprint": "plutoprint", "prometheus-client": "prometheus_client", "psycopg": "psycopg",
    "pyarrow": "pyarrow", "pycdr2": "pycdr2", "pydicom": "pydicom", "pyigtl": "pyigtl", "pylsl": "pylsl",
    "pyserial": "serial", "resvg-py": "resvg_py", "ruckig": "ruckig", "scikit-image": "skimage",
    "scipy": "scipy", "setproctitle": "setproctitle", "threadpoolctl": "threadpoolctl", "trimesh": "trimesh",
    "uvloop": "uvloop", "zstandard": "zstandard",
}  # fmt: skip
"""Names of packages to the modules that are imported."""
BROUGHT_ALONG = {"fastapi", "uvicorn"}  # by NiceGUI
BASE_MODULES = (
    "client", "planner", "fsm", "fsm.verify", "authoring.chart", "cli.cell", "cli.lease", "cli.fsm", "journal", "pki",
)  # fmt: skip
"""Below `pcmrs`; they need no extra."""
TO_INSTALL = (
    (("serve",), "pcmrs-sim"),
    (("demo",), "pcmrs-lab"),
    (("fsm", "test", "ratms"), "pcmrs-lab"),
    (("fsm", "render", "ratms", "--format", "png"), "extra authoring"),
    (("console",), "extra console"),
    (("record", "run.mcap"), "extra recording"),
    (("repair", "run.mcap", "-o", "saved.mcap"), "extra recording"),
    (("report", "."), "extra daemon or report"),
    (("archive", "list", "--archive", "."), "extra archive"),
)
"""Command to what it needs beside the base install."""
RUN_EACH = """
import json, traceback
from click.testing import CliRunner
from pcmrs.cli import main
ended = [CliRunner().invoke(main, words, prog_name="pcmrs") for words in {commands!r}]
for each in ended:
    if each.exception is not None and not isinstance(each.exception, SystemExit):
        traceback.print_exception(each.exception)
print(json.dumps([(each.exit_code, each.stderr) for each in ended]))
"""
"""Commands in one process, which prints their exit statuses and what they say on standard error."""


def run_python(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=False)


def run_pcmrs(hiding: str, *words: str) -> subprocess.CompletedProcess[str]:
    return run_python(f"{hiding}\nfrom pcmrs.cli import main\nmain({list(words)!r}, prog_name='pcmrs')")


def test_client_loads_no_arithmetic_and_no_simulation() -> None:
    heavy = {"numpy", "scipy", "pinocchio", "mujoco", "ruckig", "pcmrs_sim"}
    done = run_python(f"import sys, pcmrs.client; print({heavy} & set(sys.modules))")
    assert (done.stdout.strip(), done.returncode) == ("set()", 0), done.stderr


@pytest.mark.parametrize("hiding", [BASE, WINDOWS], ids=["base", "windows"])
def test_the_base_install_is_imported_without_any_extra(hiding: str) -> None:
    done = run_python("\n".join((hiding, *(f"import pcmrs.{module}" for module in BASE_MODULES))))
    assert done.returncode == 0, done.stderr


def test_a_workflow_is_verified_without_any_extra() -> None:
    done = run_pcmrs(WINDOWS, "fsm", "verify", str(RATMS))
    assert (done.returncode, "sound: 40 joint states" in done.stdout) == (0, True), done.stderr
    assert "are not checked" in done.stderr
    assert "install the extra daemon" in done.stderr


def test_a_command_says_what_to_install() -> None:
    done = run_python(BASE + RUN_EACH.format(commands=[words for words, _ in TO_INSTALL]))
    assert (done.returncode, done.stderr) == (0, "")
    for (words, extra), (status, complaint) in zip(TO_INSTALL, json.loads(done.stdout), strict=True):
        assert status in (2, 4, 5), words
        assert extra in complaint, words
        assert "docs/supply.md" in complaint, words
        assert "Traceback" not in complaint, words


def test_command_that_needs_posix_is_refused_with_the_reason() -> None:
    done = run_pcmrs(WINDOWS, "serve")
    assert done.returncode == 4
    assert "run it on Linux" in done.stderr


def test_laboratory_commands_are_listed_only_where_installed() -> None:
    with_laboratory, without = (run_pcmrs(hiding, "--help").stdout for hiding in ("", HIDE.format(hidden=set(OURS))))
    names = {"faults", "experiment", "demo", "session"}
    listed, left = (set(re.findall(r"^  ([a-z0-9-]+)  ", text, re.MULTILINE)) for text in (with_laboratory, without))
    assert listed - left == names


def test_product_is_imported_without_the_simulation() -> None:
    hiding = HIDE.format(hidden={*OURS, "mujoco"})
    done = run_python(f"{hiding}\nimport pcmrs.service, pcmrs.node, pcmrs.cli.serve, pcmrs.client")
    assert done.returncode == 0, done.stderr


def test_real_device_settings_are_read_without_the_simulation() -> None:
    drivers = [f"{device}.driver=none" for device in ("robot", "tracker", "pointer", "scene", "stimulator", "emg")]
    read = f"from pcmrs.settings import read_settings\nprint(read_settings(None, {drivers}).drivers())"
    done = run_python(f"{BASE}\n{read}")
    assert (done.stdout.strip(), done.returncode) == ("{}", 0), done.stderr


def test_the_table_of_extras_is_that_of_the_distribution() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = {extra: names_of(project["optional-dependencies"][extra]) - {"pcmrs"} for extra in EXTRAS}
    assert {extra: {PACKAGES[name] for name in names} for extra, names in declared.items()} == {
        extra: set(modules) - BROUGHT_ALONG for extra, modules in EXTRAS.items()
    }


def test_the_extra_all_has_every_other_one() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["optional-dependencies"]["all"] == [f"pcmrs[{','.join(sorted(EXTRAS))}]"]


def names_of(requirements: Iterable[str]) -> set[str]:
    return {re.split(r"[\[><=; ]", each)[0] for each in requirements}
