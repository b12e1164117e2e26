"""The commands of pcmrs-sim: refused arguments, the list of faults, and help."""

import json
import socket
from collections.abc import Iterator

import pytest
import structlog
from click.testing import CliRunner

from pcmrs_sim.cli import main
from pcmrs_sim.faults import FAULTS


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (["kst", "--port", "0", "--model", "ur5"], 4, "has 6"),
        (["kst", "--port", "0", "--set", "sim.seeed=3"], 4, "seeed"),
        (["cell", "--phantom", "knee"], 2, "knee"),
        (["ndi", "--port", "70000"], 2, "70000"),
        (["ndi", "--port", "0", "--duration", "nan"], 2, "nan is not finite"),
        (["kst", "--port", "0", "--accept-timeout", "nan"], 2, "nan is not finite"),
    ],
)
@pytest.mark.usefixtures("quiet_log")
def test_impossible_arguments_are_refused_in_one_sentence(arguments: list[str], status: int, text: str) -> None:
    ended = CliRunner().invoke(main, arguments)
    assert ended.exit_code == status
    assert text in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.usefixtures("quiet_log")
def test_taken_port_is_reported_with_the_remedy(taken_port: int) -> None:
    ended = CliRunner().invoke(main, ["kst", "--port", str(taken_port)])
    assert ended.exit_code == 5
    assert "Choose another port" in ended.stderr


@pytest.fixture
def quiet_log() -> Iterator[None]:
    """The command logs to the standard error of its time, which is closed after it."""
    yield
    structlog.reset_defaults()


@pytest.fixture
def taken_port() -> Iterator[int]:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen(1)
        yield holder.getsockname()[1]


def test_the_faults_are_listed() -> None:
    listed = json.loads(CliRunner().invoke(main, ["faults", "--json"]).output)
    assert {row["name"] for row in listed} == set(FAULTS)
    text = CliRunner().invoke(main, ["faults"]).output
    assert "B5   e_stop <on>" in text


@pytest.mark.parametrize("command", ["kst", "ndi", "cell", "render", "faults"])
def test_every_command_says_how_it_is_used(command: str) -> None:
    help_text = CliRunner().invoke(main, [command, "--help"]).output
    assert "Example: " in help_text
    assert f"pcmrs-sim {command}" in help_text
