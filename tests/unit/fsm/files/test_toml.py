"""Whatever bytes are read as a blueprint: a finding with its place, or success; never an exception, never for long."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm import Finding, examine
from pcmrs.fsm.files.toml import MAX_BYTES
from tests.support.ratms_oracle import BLUEPRINT
from tests.support.trials import examples

RATMS = BLUEPRINT.read_bytes()


def only(raw: bytes) -> Finding:
    examination = examine(raw, origin="x.toml")
    assert not examination.readable
    (finding,) = examination.findings
    return finding


@pytest.mark.parametrize(
    ("raw", "code", "line", "column"),
    [
        (b"", "bad_value", 1, 1),
        (b"id = ", "not_toml", 1, 0),
        (b'id = "x"\nversion = [1,\n', "not_toml", 3, 0),
        (b'id = "x"\n\xc3\xa4 = "\xff"', "not_utf8", 2, 6),
        (b"x = 1" + b"0" * 5000, "not_toml", 1, 0),
        (b"id = 'x'\nversion = 1", "bad_value", 2, 1),
        (b"id = 'x'\n  colour = 'red'\nversion = '1'\nbranches = {}", "bad_value", 2, 3),
        (b"\n[[[[", "not_toml", 2, 3),
        (b"#" * (MAX_BYTES + 1), "too_large", 1, 1),
        (b"a." * 100_000 + b"b = 1", "too_deep", 1, 1),
        (b"[" + b"a." * 100_000 + b"b]", "too_deep", 1, 2),
        (b"x = " + b"[" * 100_000 + b"]" * 100_000, "too_deep", 1, 0),
        (b"x = " + b"{a=" * 50_000 + b"1" + b"}" * 50_000, "too_deep", 1, 0),
        (b"x = " + b"[" * 100_000, "too_deep", 1, 0),
    ],
)
def test_unreadable_file_is_a_finding_with_its_place(raw: bytes, code: str, line: int, column: int) -> None:
    finding = only(raw)
    assert (finding.code, finding.file, finding.line) == (code, "x.toml", line)
    assert not column or finding.column == column


BAD_VALUES = {
    # what is replaced in the blueprint of RATMS, by what, the line that is pointed to, and where it is said to be
    "unknown key of the file": ('version = "1', 'author = "me"\nversion = "1', 'author = "me"', "author"),
    "unknown key of a branch": (
        "[branches.robot]",
        "[branches.robot]\ncolour = 1",
        "colour",
        "branches.robot.colour",
    ),
    "unknown key of an operation": (
        "[branches.robot.operations.connect]\n",
        '[branches.robot.operations.connect]\nwhen = "now"\n',
        "when",
        "branches.robot.operations.connect.when",
    ),
    "motion that is none": (
        'motion = "retreat"\npayload = "retreat"\nrequires = { robot = ["1"] }\nchecks = ["home_',
        'motion = "sideways"\npayload = "retreat"\nrequires = { robot = ["1"] }\nchecks = ["home_',
        "sideways",
        "branches.placement.operations.home.motion",
    ),
    "level as text": (
        'level = 2\ntitle = "Placement',
        'level = "2"\ntitle = "Placement',
        '"2"',
        "branches.placement.level",
    ),
    "number among names": (
        'from = ["standoff", "placed", "following", "guided", "replanned"]\nto = "held"',
        'from = ["standoff", 7]\nto = "held"',
        'from = ["standoff", 7]',
        "branches.placement.revocations.0.from.1",
    ),
}


@pytest.mark.parametrize("fault", BAD_VALUES)
def test_a_wrong_value_is_found_in_the_tree_of_keys(fault: str) -> None:
    old, new, line, path = BAD_VALUES[fault]
    text = RATMS.decode()
    assert old in text
    text = text.replace(old, new, 1)
    finding = only(text.encode())
    assert finding.code == "bad_value"
    assert ".".join(finding.path) == path
    assert line in text.split("\n")[finding.line - 1]


@given(st.binary(max_size=300))
def test_any_bytes(raw: bytes) -> None:
    assert not examine(raw).sound or raw


@examples(60)
@given(st.integers(0, 2**32), st.integers(1, 6))
def test_any_damage_to_a_blueprint(seed: int, cuts: int) -> None:
    """Bytes of a sound blueprint swapped, cut, doubled and overwritten end in findings that point into the file."""
    chance, raw = random.Random(seed), bytearray(RATMS)
    for _ in range(cuts):
        begin = chance.randrange(len(raw))
        end = min(len(raw), begin + chance.choice((1, 2, 8, 40, 400)))
        other = chance.randrange(len(raw))
        raw[begin:end] = chance.choice((b"", bytes(raw[other : other + end - begin]), chance.randbytes(end - begin)))
    findings = examine(bytes(raw)).findings
    lines = bytes(raw).count(b"\n") + 1
    assert all(finding.code and finding.text and 1 <= finding.line <= lines for finding in findings)


def test_a_file_too_large_is_not_read() -> None:
    found = examine(b"#" * (MAX_BYTES + 1), origin="large").findings
    assert [finding.code for finding in found] == ["too_large"]
