"""Table of attackers and entry points: which tests and catalogue rows show that an attack has no forbidden effect.

Rows are in the table by what they declare and record (`pcmrs_lab.campaign.tries`). ``attacks.toml`` adds tests, and the
reason for each cell without a proof.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib.resources import files

import msgspec

from pcmrs_lab.campaign.injections import injections

_ROW = re.compile(r"[A-Z]\d+")


class Attack(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Attack by some attackers on some entry points.

    Attributes:
        ways: Entry points, from `Attacks.ways`.
        by: Attackers, from `Attacks.attackers`.
        shown_by: Proofs: rows of the catalogue, and tests below ``tests/``.
    """

    ways: list[str]
    by: list[str]
    shown_by: list[str]


class NoProof(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Attackers on entry points for which there is no row and no test.

    Attributes:
        ways: Entry points, from `Attacks.ways`.
        by: Attackers, from `Attacks.attackers`.
        reason: Reason, as a sentence without its full stop.
    """

    ways: list[str]
    by: list[str]
    reason: str


class Attacks(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All attacks that were tried, and the reasons for the others.

    Attributes:
        ways: Entry points: keys, ports, pages and files through which something reaches a cell.
        attackers: Persons, programs or devices that try them.
        attacks: Attacks that were tried.
        no_proof: Cells of the table without a proof; of several reasons for a cell the first counts.
    """

    ways: list[str]
    attackers: list[str]
    attacks: list[Attack]
    no_proof: list[NoProof] = []

    def proofs(self, way: str, attacker: str) -> list[str]:
        """Return the rows and tests that try this attacker on this entry point.

        Args:
            way: Entry point, one of `ways`.
            attacker: Attacker, one of `attackers`.
        """
        found = (each.shown_by for each in self.attacks if way in each.ways and attacker in each.by)
        return list(dict.fromkeys(proof for shown_by in found for proof in shown_by))

    def reason(self, way: str, attacker: str) -> str:
        """Return why there is no proof; empty if no reason is given.

        Args:
            way: Entry point, one of `ways`.
            attacker: Attacker, one of `attackers`.
        """
        return next((each.reason for each in self.no_proof if way in each.ways and attacker in each.by), "")


@cache
def attacks() -> Attacks:
    """Return the attacks of all rows, and those of ``attacks.toml``."""
    text = files("pcmrs_lab.campaign").joinpath("attacks.toml").read_text(encoding="utf-8")
    known = msgspec.convert(tomllib.loads(text), Attacks)
    return msgspec.structs.replace(known, attacks=[*_of_rows(known), *known.attacks])


def _of_rows(known: Attacks) -> Iterator[Attack]:
    """Yield one attack for each attacker of a row, in the order of the table."""
    rows = sorted(injections().items(), key=lambda row: (row[0][0], int(row[0][1:])))
    for row, ways in rows:
        tries = {each for injection in ways for each in injection.tries}
        for attacker in sorted({each.by for each in tries}, key=known.attackers.index):
            on = sorted((each.way for each in tries if each.by == attacker), key=known.ways.index)
            yield Attack(on, [attacker], [row])


def attacks_as_markdown() -> str:
    """Return a Markdown table of attackers by entry points, with their proofs, and below it tests and reasons."""
    known = attacks()
    cells = {(way, by): known.proofs(way, by) for way in known.ways for by in known.attackers}
    tests = list(dict.fromkeys(proof for each in known.attacks for proof in each.shown_by if not _ROW.fullmatch(proof)))
    reasons = list(dict.fromkeys(known.reason(*cell) for cell, proofs in cells.items() if not proofs))
    lines = ["| entry point | " + " | ".join(known.attackers) + " |", "| --- " * (len(known.attackers) + 1) + "|"]
    for way in known.ways:
        shown = (
            " ".join(_short(cells[way, by], tests)) or f"n{reasons.index(known.reason(way, by)) + 1}"
            for by in known.attackers
        )
        lines.append(f"| {way} | " + " | ".join(shown) + " |")
    lines += ["", *(f"- t{number}: {_named(test)}" for number, test in enumerate(tests, 1))]
    lines += ["", *(f"- n{number}: no proof: {reason}." for number, reason in enumerate(reasons, 1))]
    return "\n".join(lines) + "\n"


def _named(test: str) -> str:
    """Return the name of a test as code, followed by its mark, such as ``(browser)``, if it has one."""
    name, separator, mark = test.partition(" ")
    return f"`{name}`{separator}{mark}"


def _short(proofs: list[str], tests: list[str]) -> Iterator[str]:
    for proof in proofs:
        yield proof if _ROW.fullmatch(proof) else f"t{tests.index(proof) + 1}"
