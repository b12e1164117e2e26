"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from pcmrs.cli.options import CellAddress, OutputFile, address_options
from pcmrs.errors import ConfigurationError
from tests.unit.cli.command_line import run


def test_options_for_a_cell_are_refused_where_no_cell_is_tested() -> None:
    for option in (["--connect"], ["--rate", "5"], ["--arguments", "mine.toml"], ["--set", "sim.seed=2"]):
        ended = run("fsm", "test", "ratms", *option)
        assert ended.exit_code == 2
        assert f"{option[0]} is for --live only" in ended.stderr


def test_without_an_identity_there_are_no_credentials(tmp_path: Path) -> None:
    assert CellAddress("tcp/127.0.0.1:7447", "lab", "cell1").credentials() is None
    with pytest.raises(ConfigurationError, match="none"):
        CellAddress("tls/router:7449", "lab", "cell1", tmp_path / "none").credentials()


def test_an_address_comes_from_options_or_the_environment() -> None:
    @click.command()
    @address_options
    def show(address: CellAddress) -> None:
        click.echo(f"{address.endpoint} {address.site} {address.cell}")

    environment = {"PCMRS_ENDPOINT": "tcp/robot:1", "PCMRS_SITE": "or", "PCMRS_CELL": "", "PCMRS_IDENTITY": ""}
    assert CliRunner(env=environment).invoke(show, ["--site", "lab"]).stdout == "tcp/robot:1 lab cell1\n"


def test_a_file_in_a_missing_folder_is_refused_before_the_work(tmp_path: Path) -> None:
    assert OutputFile().convert(str(tmp_path / "a.png"), None, None) == tmp_path / "a.png"
    with pytest.raises(click.BadParameter, match=r"there is no folder .*none; create it first"):
        OutputFile().convert(str(tmp_path / "none" / "a.png"), None, None)
    with pytest.raises(click.BadParameter, match="is a directory"):
        OutputFile().convert(str(tmp_path), None, None)
