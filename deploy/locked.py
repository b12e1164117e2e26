#!/usr/bin/env python3
"""Prints what of requirements.lock an installation needs, with versions and hashes.

    python3 deploy/locked.py sim hardware > locked.txt
    pip install --require-hashes --requirement locked.txt

The words are extras of PCMRS, and `sim` and `lab` for its other two distributions. It needs Python 3.11 and the
checkout, and asks no index for anything.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DISTRIBUTIONS = {"pcmrs": ".", "pcmrs-sim": "sim", "pcmrs-lab": "lab"}
"""Names of ours, and the folders of their pyproject.toml."""

_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)(?:\[([^\]]*)\])?")


def locked(words: list[str]) -> str:
    """Return the part of the lock that the product, these extras and these distributions need.

    Raises:
        SystemExit: There is no such extra, or the lock does not have it.
    """
    extras = _project("pcmrs")["optional-dependencies"]
    others = {folder: name for name, folder in DISTRIBUTIONS.items() if folder != "."}
    for word in words:
        if word not in extras and word not in others:
            raise SystemExit(f"{word!r} is no extra; there are {', '.join((*others, *extras))}.")
    wanted = _required(["pcmrs", *(others.get(word) or f"pcmrs[{word}]" for word in words)])
    entries = _entries((ROOT / "requirements.lock").read_text(encoding="utf-8"))
    chosen: set[str] = set()
    while wanted - chosen:
        chosen |= wanted
        if chosen - entries.keys():
            raise SystemExit(f"requirements.lock does not have {', '.join(sorted(chosen - entries.keys()))}.")
        wanted = {name for name, (_, needed_by) in entries.items() if needed_by & chosen}
    return "".join(entries[name][0] for name in entries if name in chosen)


def _required(requirements: list[str]) -> set[str]:
    """Names of the packages of others that these requirements lead to through our own distributions."""
    found: set[str] = set()
    seen: set[str] = set()
    while requirements:
        name, extras = _parts(requirements.pop())
        if name not in DISTRIBUTIONS:
            found.add(name)
            continue
        project = _project(name)
        parts = {"": project["dependencies"], **project.get("optional-dependencies", {})}
        for part in {"", *extras}:
            if f"{name}[{part}]" not in seen:
                seen.add(f"{name}[{part}]")
                requirements += parts[part]
    return found


def _project(name: str) -> dict[str, object]:
    text = (ROOT / DISTRIBUTIONS[name] / "pyproject.toml").read_text(encoding="utf-8")
    project: dict[str, object] = tomllib.loads(text)["project"]
    return project


def _entries(lock: str) -> dict[str, tuple[str, set[str]]]:
    """Each package with its lines, and the packages that it is needed by."""
    entries = {}
    for entry in re.split(r"^(?=[A-Za-z0-9])", lock.partition("\n# The following")[0], flags=re.MULTILINE)[1:]:
        _, _, by = entry.partition("# via")
        names = re.findall(r"[A-Za-z0-9._\[\]-]+(?= *$|\n)", by)
        entries[_parts(entry)[0]] = entry, {_parts(name)[0] for name in names}
    return entries


def _parts(requirement: str) -> tuple[str, list[str]]:
    """Name of a package, as indexes write it, and the extras that are asked for."""
    match = _REQUIREMENT.match(requirement)
    if match is None:
        raise SystemExit(f"{requirement!r} is no requirement.")
    extras = [extra.strip() for extra in (match[2] or "").split(",")]
    return re.sub(r"[-_.]+", "-", match[1]).lower(), [extra for extra in extras if extra]


if __name__ == "__main__":
    sys.stdout.write(locked(sys.argv[1:]))
