"""Options that several commands share."""

from __future__ import annotations

from tests.unit.cli.command_line import run


def test_options_for_a_cell_are_refused_where_no_cell_is_tested() -> None:
    for option in (["--connect"], ["--rate", "5"], ["--arguments", "mine.toml"], ["--set", "sim.seed=2"]):
        ended = run("fsm", "test", "ratms", *option)
        assert ended.exit_code == 2
        assert f"{option[0]} is for --live only" in ended.stderr
