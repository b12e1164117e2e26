"""What the base install can do without the extras, and what its smallest part does not load."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from importlib.metadata import requires

import pytest

HIDE_SIM_EXTRA = """
import sys
from importlib.machinery import PathFinder
find = PathFinder.find_spec
def find_visible(name, *where):
    return None if name in {"mujoco", "example_robot_data"} else find(name, *where)
PathFinder.find_spec = find_visible
"""
"""Makes the modules of the extra `sim` as good as not installed."""


def run_python(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=False)


def test_client_loads_no_arithmetic_and_no_simulation() -> None:
    heavy = {"numpy", "scipy", "pinocchio", "mujoco", "ruckig", "sim"}
    done = run_python(f"import sys, pcmrs.client; print({heavy} & set(sys.modules))")
    assert (done.stdout.strip(), done.returncode) == ("set()", 0), done.stderr


@pytest.mark.parametrize("module", ["pcmrs.service", "pcmrs.node", "pcmrs.cli.serve", "pcmrs.client"])
def test_product_is_imported_without_the_simulation(module: str) -> None:
    done = run_python(f"{HIDE_SIM_EXTRA}\nimport {module}\nprint('sim' in sys.modules)")
    assert (done.stdout.strip(), done.returncode) == ("False", 0), done.stderr


def test_daemon_says_that_the_simulated_driver_is_not_installed() -> None:
    done = run_python(f"{HIDE_SIM_EXTRA}\nfrom pcmrs.cli.serve import serve\nserve([])")
    assert done.returncode == 4
    assert "'sim' is not installed" in done.stderr
    assert "pcmrs[sim]" in done.stderr
    assert "Traceback" not in done.stderr


def test_settings_of_real_devices_are_read_without_the_simulation() -> None:
    drivers = [f"{device}.driver=none" for device in ("robot", "tracker", "pointer", "scene", "stimulator", "emg")]
    read = f"from pcmrs.settings import read_settings\nprint(read_settings(None, {drivers}).drivers())"
    done = run_python(f"{HIDE_SIM_EXTRA}\n{read}")
    assert (done.stdout.strip(), done.returncode) == ("{}", 0), done.stderr


def test_simulator_belongs_to_the_extra() -> None:
    asked = [line for line in requires("pcmrs") or [] if line.startswith(("mujoco", "example-robot-data"))]
    assert asked
    assert all("extra == 'sim'" in line.replace('"', "'") for line in asked)
