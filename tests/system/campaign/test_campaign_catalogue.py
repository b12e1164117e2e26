"""The catalogue is whole, and all of it is injected."""

from __future__ import annotations

import json
from typing import Any

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.errors import ConfigurationError
from pcmrs_lab.campaign.attacks import attacks, attacks_as_markdown
from pcmrs_lab.campaign.catalogue import CLASSES, RESPONSES, catalogue, choose
from pcmrs_lab.campaign.fault import fault
from pcmrs_lab.campaign.injections import injections
from tests import ROOT

COUNTS = {"O": 13, "S": 14, "B": 14, "N": 14, "P": 13, "T": 12, "C": 6, "A": 40, "Q": 29}
LETTERS = dict(zip(COUNTS, CLASSES, strict=True))
WRONG_IN_THE_REFERENCE = {
    *("O2", "O4", "O6", "O7", "O11"),
    *("B1", "B2", "B3", "B10", "B11"),
    *("N5", "N7", "N14", "T10", "C1"),
    *("A5", "A6", "A8"),
}


def test_every_row_is_there_once_and_in_its_class() -> None:
    expected = [f"{letter}{number + 1}" for letter, count in COUNTS.items() for number in range(count)]
    assert list(catalogue()) == expected
    assert len(expected) == 155
    for row in catalogue().values():
        assert row.fault_class == LETTERS[row.id[0]]
        assert row.title
        assert row.required


def test_only_faults_that_the_reference_gets_wrong_are_marked_so() -> None:
    assert {row.id for row in catalogue().values() if row.reference} == WRONG_IN_THE_REFERENCE


@pytest.mark.parametrize("fault_class", ["operator", "sensor", "robot"])
def test_every_row_of_a_class_is_injected(fault_class: str) -> None:
    rows = choose([fault_class])
    assert not {row.id for row in rows} - injections().keys()
    for row in rows:
        ways = [way.how for way in injections()[row.id]]
        assert all(ways)
        assert len(set(ways)) == len(ways)


def test_letters_of_responses_are_explained() -> None:
    used = {word.strip(",:") for row in catalogue().values() for word in row.required.split()}
    assert {word for word in used if len(word) == 1 and word.isupper()} == set(RESPONSES)


def test_rows_are_chosen_by_class_and_id() -> None:
    assert choose() == list(catalogue().values())
    assert [row.id for row in choose(["clock"], ["S3"])] == ["S3", "C1", "C2", "C3", "C4", "C5", "C6"]


@pytest.mark.parametrize(("classes", "ids", "word"), [(["weather"], [], "weather"), ([], ["Z9", "S3"], "Z9")])
def test_unknown_class_or_fault_is_named(classes: list[str], ids: list[str], word: str) -> None:
    with pytest.raises(ConfigurationError, match=word):
        choose(classes, ids)


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


def test_nothing_is_registered_for_a_fault_that_does_not_exist() -> None:
    with pytest.raises(ConfigurationError, match="Z9"):
        fault("Z9", how="by magic")


def test_attacks_name_known_ways_attackers_and_proofs() -> None:
    """That the tests are there is looked for in the document that names them."""
    known = attacks()
    for attack in known.attacks:
        assert set(attack.ways) <= set(known.ways)
        assert set(attack.by) <= set(known.attackers)
        assert all("::" in proof or proof in catalogue() for proof in attack.shown_by)
    for way in known.ways:
        assert any(known.proofs(way, attacker) for attacker in known.attackers), way


def test_every_row_of_an_adversary_is_in_the_table_of_attacks() -> None:
    shown = {proof for attack in attacks().attacks for proof in attack.shown_by}
    assert {row.id for row in choose(["adversary"])} - shown == {
        "A14",  # of who may send, and too long
        *("A39", "A40"),  # before a daemon runs
    }


def test_the_threat_model_has_the_table_of_attacks() -> None:
    document = (ROOT / "docs" / "threat-model.md").read_text()
    assert attacks_as_markdown() in document
    assert attacks_as_markdown() == CliRunner().invoke(main, ["faults", "matrix"]).output
