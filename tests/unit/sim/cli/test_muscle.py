"""The command `pcmrs-sim muscle`: refused arguments, and what it says without Lab Streaming Layer."""

import pytest
from click.testing import CliRunner

from pcmrs.errors import ConfigurationError
from pcmrs_sim.cli.muscle import muscle
from pcmrs_sim.lsl import streams


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--hum", "55"], "55"),
        (["--seed", "-1"], "-1"),
        (["--preactivation", "1000.1"], "1000.1"),
        (["--preactivation", "-1"], "-1"),
    ],
)
def test_impossible_arguments_are_refused_with_the_value(arguments: list[str], text: str) -> None:
    ended = CliRunner().invoke(muscle, arguments)
    assert ended.exit_code == 2
    assert text in ended.stderr


def test_without_lab_streaming_layer_the_remedy_is_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise ConfigurationError("Lab Streaming Layer is not installed; install pcmrs[recording].")

    monkeypatch.setattr(streams, "load_lsl", missing)
    ended = CliRunner().invoke(muscle, [])
    assert ended.exit_code == 1
    assert ended.stderr == "Error: Lab Streaming Layer is not installed; install pcmrs[recording].\n"
    assert ended.stdout == ""
