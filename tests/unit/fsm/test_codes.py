"""The kinds of findings: all are documented, and no finding is of another kind."""

from __future__ import annotations

import re

from pcmrs.fsm._codes import CODES
from tests import ROOT


def test_every_kind_is_documented_as_it_is() -> None:
    documented = dict(re.findall(r"^\| `(\w+)` \| (.+) \|$", (ROOT / "docs/fsm.md").read_text(), re.MULTILINE))
    assert {code: documented.get(code) for code in CODES} == CODES


def test_listed_codes_are_exactly_those_that_the_source_names() -> None:
    packages = [ROOT / "pcmrs" / name for name in ("fsm", "authoring")]
    files = [file for package in packages for file in package.rglob("*.py")]
    source = "".join(file.read_text() for file in files if file.name != "_codes.py")
    named = set(re.findall(r'code="(\w+)"', source)) | set(re.findall(r'_refuse\(origin, "(\w+)"', source))
    assert named <= set(CODES)
    assert {code for code in CODES if f'"{code}"' not in source} == set()
