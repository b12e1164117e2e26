"""Options of the simulated world, as a command gets them."""

from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from pcmrs_sim.cli.options import world_options


def options_of(*arguments: str) -> dict[str, Any]:
    taken: list[dict[str, Any]] = []

    @click.command()
    @world_options
    def command(**options: Any) -> None:
        taken.append(options)

    ended = CliRunner().invoke(command, arguments, standalone_mode=False, catch_exceptions=False)
    if isinstance(ended.exception, BaseException):
        raise ended.exception
    return taken[0]


def test_options_become_settings_of_the_whole_configuration() -> None:
    options = options_of("--seed", "3", "--phantom", "femur", "--model", "iiwa7", "--set", "sim.tracker.rate_hz=20")
    assert options["settings"] == {
        "sim": {"seed": 3, "phantom": "femur", "tracker": {"rate_hz": 20}},
        "robot": {"model": "iiwa7", "driver": "kst"},
    }
    assert (options["schedule"], options["duration"], options["as_json"]) == (None, None, False)


def test_a_setting_overrides_an_option_but_not_the_force_guard() -> None:
    """The driver of a real arm guards the force, and so must that of a virtual one."""
    settings = options_of("--seed", "3", "--set", "sim.seed=4", "--set", "robot.driver=sim")["settings"]
    assert settings["sim"]["seed"] == 4
    assert settings["robot"]["driver"] == "kst"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--seed", "-1"], "-1"),
        (["--phantom", "knee"], "knee"),
        (["--duration", "inf"], "inf"),
        (["--duration", "-1"], "-1"),
        (["--schedule", "nowhere.txt"], "nowhere.txt"),
    ],
)
def test_impossible_values_are_refused_with_the_value(arguments: list[str], text: str) -> None:
    with pytest.raises(click.UsageError, match=text):
        options_of(*arguments)


def test_a_schedule_is_a_path_and_a_duration_is_in_seconds(tmp_path: Path) -> None:
    file = tmp_path / "faults.txt"
    file.touch()
    options = options_of("--schedule", str(file), "--duration", "2.5", "--json")
    assert (options["schedule"], options["duration"], options["as_json"]) == (file, 2.5, True)
