"""Processes of a cell start without the libraries that only show tables and tracebacks."""

from __future__ import annotations

import subprocess
import sys

import pytest

STARTED = {
    "daemon": "import pcmrs.cli.serve, pcmrs.service",
    "node": "import pcmrs.cli.serve, pcmrs.node",
    "planner": "import pcmrs.workflows.planning_process",
    "recorder": "import pcmrs.cli.recording",
    "world": "import pcmrs_sim.process.world",
    "router": "import pcmrs.cli.router",
    "console": "import pcmrs.cli.console",
}


@pytest.mark.parametrize("process", STARTED)
def test_process_of_a_cell_does_not_load_rich(process: str) -> None:
    code = f"{STARTED[process]}\nimport structlog, sys\nassert not sys.modules.keys() & {{'rich', 'pygments'}}"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_stop_loads_neither_rich_nor_structlog() -> None:
    code = "import pcmrs.cli.cell, pcmrs.client, sys\nassert not sys.modules.keys() & {'rich', 'pygments', 'structlog'}"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_rich_can_be_used_after_structlog() -> None:
    """The command line prints its tables with it."""
    code = "import pcmrs.cli.serve, structlog, rich.table, pcmrs.cli.tables\nassert structlog.dev.rich is None"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_structlog_of_a_user_is_left_as_it_is() -> None:
    code = "import structlog, pcmrs.cli.serve\nassert structlog.dev.rich is not None"
    subprocess.run([sys.executable, "-c", code], check=True)
