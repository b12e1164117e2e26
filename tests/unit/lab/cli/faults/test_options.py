"""Options that the fault commands share, and how they end where something was violated."""

from __future__ import annotations

import json
import stat
from pathlib import Path
from typing import Any

import click
import msgspec
import pytest
from click.testing import CliRunner, Result
from rich.table import Table

from pcmrs_lab.campaign.catalogue import catalogue
from pcmrs_lab.cli.faults.options import (
    PartOf,
    choosing,
    chosen,
    minutes_option,
    output_option,
    print_findings,
    seed_option,
)


class Finding(msgspec.Struct, frozen=True):
    kills: int


def given(*words: str) -> tuple[Result, dict[str, Any]]:
    taken: dict[str, Any] = {}

    @click.command()
    @click.option("--part", type=PartOf(), default="1/1")
    @choosing
    @seed_option
    @minutes_option
    @output_option("Write it")
    def command(**options: Any) -> None:
        taken.update(options)

    return CliRunner().invoke(command, words), taken


@pytest.mark.parametrize(("text", "part"), [("1/1", (1, 1)), ("2/3", (2, 3)), ("16/16", (16, 16))])
def test_a_part_is_the_k_th_of_n(text: str, part: tuple[int, int]) -> None:
    assert given("--part", text)[1]["part"] == part


@pytest.mark.parametrize("text", ["0/2", "3/2", "1/0", "1", "/", "1/2/3", "-1/2", "a/b", "1.0/2", ""])
def test_what_is_no_part_is_refused_with_an_example(text: str) -> None:
    ended, taken = given("--part", text)
    assert (ended.exit_code, taken) == (2, {})
    assert "write 2/3 for the second of three" in ended.stderr


@pytest.mark.parametrize("words", [("--minutes", "0"), ("--minutes", "nan"), ("--minutes", "-1"), ("--seed", "-1")])
def test_impossible_limits_and_seeds_are_refused(words: tuple[str, ...]) -> None:
    ended, taken = given(*words)
    assert (ended.exit_code, taken) == (2, {})
    assert words[0] in ended.stderr


def test_the_output_folder_is_made_at_once(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "in new"
    assert given("-o", str(folder))[1]["folder"] == folder
    assert folder.is_dir()


def test_a_folder_that_cannot_be_made_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    ended, taken = given("-o", str(tmp_path / "file" / "below"))
    assert (ended.exit_code, taken) == (2, {})
    assert "cannot be created: Not a directory" in " ".join(ended.stderr.split())
    assert not stat.S_ISDIR((tmp_path / "file").stat().st_mode)


def test_rows_chosen_by_class_and_id_and_unknown_ones_refused() -> None:
    assert chosen((), ()) == list(catalogue().values())
    assert {row.id for row in chosen(("clock",), ("S3",))} == {"S3", "C1", "C2", "C3", "C4", "C5", "C6"}
    with pytest.raises(click.UsageError, match="Unknown fault Z9"):
        chosen((), ("Z9",))


@pytest.mark.parametrize(("violated", "status"), [([False, False], 0), ([False, True], 1), ([], 0)])
@pytest.mark.parametrize("as_json", [True, False])
def test_one_violated_report_makes_the_exit_status_1(violated: list[bool], status: int, as_json: bool) -> None:
    reports = [Finding(number) for number in range(len(violated))]

    @click.command()
    def command() -> None:
        print_findings(reports, violated, Table("killed", title="Kills"), as_json=as_json)

    ended = CliRunner().invoke(command)
    assert ended.exit_code == status
    if as_json:
        found = [{"kills": number, "violated": wrong} for number, wrong in enumerate(violated)]
        assert json.loads(ended.stdout) == {"simulated": True, "reports": found}
    else:
        assert ended.stdout.strip().startswith(("Kills", "killed", "┏"))
