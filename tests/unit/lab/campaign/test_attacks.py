"""The table of attacks has a proof or a reason in each cell, and is the one of the threat model."""

from __future__ import annotations

from pcmrs_lab.campaign.attacks import Attack, Attacks, NoProof, attacks, attacks_as_markdown
from pcmrs_lab.campaign.catalogue import catalogue, choose
from pcmrs_lab.campaign.injections import injections
from pcmrs_lab.campaign.tries import Try
from tests import ROOT


def test_attacks_name_known_ways_attackers_and_proofs() -> None:
    """That the tests are there is looked for in the document that names them."""
    known = attacks()
    for attack in known.attacks:
        assert set(attack.ways) <= set(known.ways)
        assert set(attack.by) <= set(known.attackers)
        assert all("::" in proof or proof in catalogue() for proof in attack.shown_by)
    for each in known.no_proof:
        assert set(each.ways) <= set(known.ways)
        assert set(each.by) <= set(known.attackers)


def test_a_row_is_in_the_cells_that_it_declares_and_in_no_other() -> None:
    known = attacks()
    for row in choose(["adversary"]):
        wanted = {each for injection in injections()[row.id] for each in injection.tries}
        shown = {Try(way, by) for way in known.ways for by in known.attackers if row.id in known.proofs(way, by)}
        assert shown == wanted, row.id


def test_every_row_of_an_adversary_declares_what_it_tries() -> None:
    silent = {row.id for row in choose(["adversary"]) for injection in injections()[row.id] if not injection.tries}
    assert silent == {"A39", "A40"}, "before a daemon runs"


def test_every_cell_has_a_proof_or_a_reason() -> None:
    known = attacks()
    cells = [(way, by) for way in known.ways for by in known.attackers]
    assert [cell for cell in cells if not known.proofs(*cell) and not known.reason(*cell)] == []
    used = {known.reason(*cell) for cell in cells if not known.proofs(*cell)}
    assert {each.reason for each in known.no_proof} == used


def test_the_threat_model_has_the_table_of_attacks() -> None:
    document = (ROOT / "docs" / "threat-model.md").read_text()
    assert attacks_as_markdown() in document


def test_proof_is_listed_once_and_the_first_reason_counts() -> None:
    table = Attacks(
        ways=["key", "port"],
        attackers=["viewer", "stranger"],
        attacks=[
            Attack(["key", "port"], ["viewer"], ["A1", "unit/test_a.py::test_b"]),
            Attack(["key"], ["viewer", "stranger"], ["A2", "A1"]),
        ],
        no_proof=[NoProof(["port"], ["stranger"], "not tried"), NoProof(["port", "key"], ["stranger"], "later")],
    )
    assert table.proofs("key", "viewer") == ["A1", "unit/test_a.py::test_b", "A2"]
    assert table.proofs("port", "stranger") == []
    assert table.reason("port", "stranger") == "not tried"
    assert table.reason("port", "viewer") == ""


def test_tests_and_reasons_are_numbered_below_the_table() -> None:
    lines = attacks_as_markdown().splitlines()
    rows = [line for line in lines if line.startswith("| ")]
    assert len(rows) == 2 + len(attacks().ways)
    assert all(line.count("|") == len(attacks().attackers) + 2 for line in rows[2:])
    for mark in "tn":
        numbered = [line for line in lines if line.startswith(f"- {mark}")]
        wanted = [f"- {mark}{number}" for number in range(1, len(numbered) + 1)]
        assert [line.partition(":")[0] for line in numbered] == wanted
