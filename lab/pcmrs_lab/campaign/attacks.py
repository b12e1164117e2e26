"""Who was let loose on which way into a cell, and what shows that it has no effect that it must not have."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib.resources import files

import msgspec

_ROW = re.compile(r"[A-Z]\d+")
NOT_TRIED = "–"


class Attack(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Attackers on ways in.

    Attributes:
        ways: In, as `Attacks.ways` has them.
        by: Attackers, as `Attacks.attackers` has them.
        shown_by: Rows of the catalogue, and tests below ``tests/``.
    """

    ways: list[str]
    by: list[str]
    shown_by: list[str]


class Attacks(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All of them.

    Attributes:
        ways: Keys, ports, pages and files by which something reaches a cell.
        attackers: Who or what tries them.
        attacks: What was tried.
    """

    ways: list[str]
    attackers: list[str]
    attacks: list[Attack]

    def proofs(self, way: str, attacker: str) -> list[str]:
        """Rows and tests that have this attacker on this way."""
        found = (each.shown_by for each in self.attacks if way in each.ways and attacker in each.by)
        return list(dict.fromkeys(proof for shown_by in found for proof in shown_by))


@cache
def attacks() -> Attacks:
    """What was tried."""
    text = files("pcmrs_lab.campaign").joinpath("attacks.toml").read_text(encoding="utf-8")
    return msgspec.convert(tomllib.loads(text), Attacks)


def attacks_as_markdown() -> str:
    """Table of attackers by ways in: rows of the catalogue, and numbers of the tests that are listed below it."""
    known = attacks()
    tests = list(
        dict.fromkeys(each for attack in known.attacks for each in attack.shown_by if not _ROW.fullmatch(each))
    )
    lines = ["| way in | " + " | ".join(known.attackers) + " |", "| --- " * (len(known.attackers) + 1) + "|"]
    for way in known.ways:
        cells = (" ".join(_short(known.proofs(way, attacker), tests)) or NOT_TRIED for attacker in known.attackers)
        lines.append(f"| {way} | " + " | ".join(cells) + " |")
    lines += ["", *(f"- t{number}: `{test}`" for number, test in enumerate(tests, 1))]
    return "\n".join(lines) + "\n"


def _short(proofs: list[str], tests: list[str]) -> Iterator[str]:
    for proof in proofs:
        yield proof if _ROW.fullmatch(proof) else f"t{tests.index(proof) + 1}"
