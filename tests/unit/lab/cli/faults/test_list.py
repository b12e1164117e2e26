"""`pcmrs faults list`: what a row needs, and which of that this machine does not have."""

from __future__ import annotations

import json
from typing import Any

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs_lab.campaign import injections
from pcmrs_lab.campaign.run import NO_INJECTION

TRACED = {"strace", "root"}
DISK = {"mkfs.ext4", "mount", "umount", "loop devices", "root"}
NEEDS = {
    **dict.fromkeys(("N14", "T2", "T3", "T8"), TRACED),
    **dict.fromkeys(("T1", "T9"), DISK),
    "T5": {*DISK, "strace"},
    **{row: {"a C compiler"} for row in ("C1", "C2", "C3")},
    "P6": {"control groups for memory", "root"},
    "P8": {"control groups for the processor", "root"},
    "A13": {"root", "ip", "nft", "network namespaces with NAT and loss"},
    "A35": {"root", "ip", "network namespaces", "pylsl"},
    "A37": {"nicegui"},
    "A38": {"nicegui"},
    "A39": {"pip"},
    "B4": {"ss"},
}


def listed(*words: str) -> list[dict[str, Any]]:
    listing = CliRunner().invoke(main, ["faults", "list", "--json", *words])
    faults: list[dict[str, Any]] = json.loads(listing.stdout)["faults"]
    return faults


def test_the_list_names_everything_that_a_row_needs() -> None:
    assert {row["id"]: set(row["needs"]) for row in listed() if row["needs"]} == NEEDS


def test_list_names_what_each_row_that_cannot_run_here_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    monkeypatch.setattr("shutil.which", lambda name: None if name == "strace" else f"/bin/{name}")
    found = {row["id"]: (set(row["missing"]) & {"root", "strace"}, row["runs"]) for row in listed("--class", "storage")}
    assert found["T2"] == ({"root", "strace"}, False)
    assert found["T1"] == ({"root"}, False)
    assert found["T4"] == (set(), True)


def test_a_row_without_injection_is_listed_and_does_not_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(injections, "injections", dict)
    (row,) = listed("--id", "S3")
    assert (row["how"], row["runs"]) == ([], False)
    shown = CliRunner().invoke(main, ["faults", "list", "--id", "S3"])
    assert NO_INJECTION in " ".join(shown.stdout.split())


def test_letters_of_responses_are_explained_below_the_table() -> None:
    shown = " ".join(CliRunner().invoke(main, ["faults", "list", "--class", "clock"]).stdout.split())
    assert "H: motion stopped and latched until an operator has confirmed" in shown


def test_an_unknown_class_is_a_usage_error() -> None:
    ended = CliRunner().invoke(main, ["faults", "list", "--class", "weather"])
    assert ended.exit_code == 2
    assert "Unknown class weather: operator, sensor" in " ".join(ended.stderr.split())
