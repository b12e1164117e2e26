#!/usr/bin/env python3
"""Prints what of requirements.lock an installation needs, with versions and hashes.

    python3 deploy/locked.py sim hardware > locked.txt
    pip install --require-hashes --requirement locked.txt

The words are extras of PCMRS. It needs Python 3.11 and the checkout, and asks no index for anything.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OURS = "pcmrs"

_NAME = re.compile(r"[A-Za-z0-9._-]+")


def locked(extras: list[str]) -> str:
    """Return the part of the lock that the product and these extras need.

    Raises:
        SystemExit: There is no such extra, or the lock does not have it.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional = project["optional-dependencies"]
    for extra in extras:
        if extra not in optional:
            raise SystemExit(f"{extra!r} is no extra; there are {', '.join(optional)}.")
    wanted = {
        _name(each) for each in [*project["dependencies"], *(each for extra in extras for each in optional[extra])]
    }
    entries = _entries((ROOT / "requirements.lock").read_text(encoding="utf-8"))
    chosen: set[str] = set()
    while wanted - chosen:
        chosen |= wanted
        if chosen - entries.keys():
            raise SystemExit(f"requirements.lock does not have {', '.join(sorted(chosen - entries.keys()))}.")
        wanted = {name for name, (_, needed_by) in entries.items() if needed_by & chosen}
    return "".join(entries[name][0] for name in entries if name in chosen)


def _entries(lock: str) -> dict[str, tuple[str, set[str]]]:
    """Each package with its lines, and the packages that it is needed by."""
    entries = {}
    for entry in re.split(r"^(?=[A-Za-z0-9])", lock, flags=re.MULTILINE)[1:]:
        _, _, by = entry.partition("# via")
        entries[_name(entry)] = entry, {_name(word) for word in re.findall(r"[A-Za-z0-9._\[\]-]+(?= *$|\n)", by)} - {""}
    return entries


def _name(requirement: str) -> str:
    match = _NAME.match(requirement)
    return re.sub(r"[-_.]+", "-", match[0]).lower() if match else ""


if __name__ == "__main__":
    sys.stdout.write(locked(sys.argv[1:]))
