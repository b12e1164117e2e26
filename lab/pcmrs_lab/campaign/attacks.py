"""Table of attackers and entry points: which tests and catalogue rows show that an attack has no forbidden effect."""

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
    """Attack by some attackers on some entry points.

    Attributes:
        ways: Entry points, from `Attacks.ways`.
        by: Attackers, from `Attacks.attackers`.
        shown_by: Proofs: rows of the catalogue, and tests below ``tests/``.
    """

    ways: list[str]
    by: list[str]
    shown_by: list[str]


class Attacks(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All attacks that were tried.

    Attributes:
        ways: Entry points: keys, ports, pages and files through which something reaches a cell.
        attackers: Persons, programs or devices that try them.
        attacks: Attacks that were tried.
    """

    ways: list[str]
    attackers: list[str]
    attacks: list[Attack]

    def proofs(self, way: str, attacker: str) -> list[str]:
        """Return the rows and tests that try this attacker on this entry point.

        Args:
            way: Entry point, one of `ways`.
            attacker: Attacker, one of `attackers`.
        """
        found = (each.shown_by for each in self.attacks if way in each.ways and attacker in each.by)
        return list(dict.fromkeys(proof for shown_by in found for proof in shown_by))


@cache
def attacks() -> Attacks:
    """Return the attacks of ``attacks.toml``."""
    text = files("pcmrs_lab.campaign").joinpath("attacks.toml").read_text(encoding="utf-8")
    return msgspec.convert(tomllib.loads(text), Attacks)


def attacks_as_markdown() -> str:
    """Return a Markdown table of attackers by entry points, with their proofs, and the tests below it."""
    known = attacks()
    tests = list(
        dict.fromkeys(each for attack in known.attacks for each in attack.shown_by if not _ROW.fullmatch(each))
    )
    lines = ["| entry point | " + " | ".join(known.attackers) + " |", "| --- " * (len(known.attackers) + 1) + "|"]
    for way in known.ways:
        cells = (" ".join(_short(known.proofs(way, attacker), tests)) or NOT_TRIED for attacker in known.attackers)
        lines.append(f"| {way} | " + " | ".join(cells) + " |")
    lines += ["", *(f"- t{number}: {_named(test)}" for number, test in enumerate(tests, 1))]
    return "\n".join(lines) + "\n"


def _named(test: str) -> str:
    """Return the name of a test as code, followed by its mark, such as ``(browser)``, if it has one."""
    name, separator, mark = test.partition(" ")
    return f"`{name}`{separator}{mark}"


def _short(proofs: list[str], tests: list[str]) -> Iterator[str]:
    for proof in proofs:
        yield proof if _ROW.fullmatch(proof) else f"t{tests.index(proof) + 1}"
