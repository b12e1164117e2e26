"""The table of attacks names known entry points, attackers and proofs, and is the one of the threat model."""

from __future__ import annotations

from pcmrs_lab.campaign.attacks import Attack, Attacks, attacks, attacks_as_markdown
from pcmrs_lab.campaign.catalogue import catalogue, choose
from tests import ROOT


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


def test_proof_is_listed_once_for_an_entry_point_and_an_attacker() -> None:
    table = Attacks(
        ways=["key", "port"],
        attackers=["viewer", "stranger"],
        attacks=[
            Attack(["key", "port"], ["viewer"], ["A1", "unit/test_a.py::test_b"]),
            Attack(["key"], ["viewer", "stranger"], ["A2", "A1"]),
        ],
    )
    assert table.proofs("key", "viewer") == ["A1", "unit/test_a.py::test_b", "A2"]
    assert table.proofs("port", "stranger") == []


def test_what_was_not_tried_is_marked_and_tests_are_numbered() -> None:
    lines = attacks_as_markdown().splitlines()
    rows = [line for line in lines if line.startswith("| ")]
    assert len(rows) == 2 + len(attacks().ways)
    assert all(line.count("|") == len(attacks().attackers) + 2 for line in rows[2:])
    numbered = [line for line in lines if line.startswith("- t")]
    assert [line.partition(":")[0] for line in numbered] == [f"- t{number}" for number in range(1, len(numbered) + 1)]
    assert any("–" in line for line in rows)
