"""Where keys are in a TOML text: by hand for what is special, and for texts that are drawn."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.cli import main
from pcmrs.errors import BlueprintError
from pcmrs.fsm import parse_blueprint
from pcmrs.fsm.files._keys import MAX_DEPTH, DepthError, TomlKey, keys_in
from pcmrs.fsm.files.load import examine
from pcmrs.fsm.files.toml import read_toml
from tests import ROOT
from tests.unit.fsm.files.pump_workflow import PUMP

TEXT = '''# [not.a.table]
a = 1 # b = 2
"q.r".s = "c = 3 # no comment"
[t . u] # ]
list = [ # [
  "x]", 'y,', # z
  [1, 2], { k = 3, "l m" = """
n = 4""" },
]
[[t.v]]
[[t.v]]
o = \'\'\'p = 5\'\'\'
[t.v.w]
"é" = 1979-05-27 07:32:00
'''

PLACES = {
    "a": (2, 1), "q.r": (3, 1), "q.r/s": (3, 1), "t": (4, 2), "t/u": (4, 2), "t/u/list": (5, 1), "t/u/list/0": (6, 3),
    "t/u/list/1": (6, 9), "t/u/list/2": (7, 3), "t/u/list/2/0": (7, 4), "t/u/list/2/1": (7, 7), "t/u/list/3": (7, 11),
    "t/u/list/3/k": (7, 13), "t/u/list/3/l m": (7, 20), "t/v": (10, 3), "t/v/0": (10, 3), "t/v/1": (11, 3),
    "t/v/1/o": (12, 1), "t/v/1/w": (13, 2),
}  # fmt: skip

keys = st.one_of(st.sampled_from(["a", "b-1", "c_2"]), st.text(max_size=3).map(lambda text: _quoted(text)))

scalars = st.one_of(
    st.integers(-5, 5).map(str),
    st.booleans().map(lambda value: str(value).lower()),
    st.text(max_size=4).map(lambda text: _quoted(text)),
    st.sampled_from(["'[#]'", '"""\n}"""', "'''\n]'''", "1979-05-27", "1e3"]),
)

gaps = st.sampled_from(["", " ", "\t", "\n", " # ] } ,\n"])


def _quoted(text: str) -> str:
    return '"' + "".join(f"\\U{ord(letter):08x}" for letter in text if not "\ud800" <= letter <= "\udfff") + '"'


@st.composite
def values(draw: st.DrawFn, depth: int = 0) -> str:
    kind = draw(st.sampled_from(["scalar", "array", "table"])) if depth < 3 else "scalar"
    if kind == "array":
        inner = [draw(gaps) + draw(values(depth + 1)) + draw(gaps) for _ in range(draw(st.integers(0, 3)))]
        return f"[{','.join(inner)}{draw(gaps)}]"
    if kind == "table":
        names = draw(st.lists(keys, max_size=3, unique_by=lambda key: _name(key)))
        return "{ " + ", ".join(f"{name} = {draw(values(depth + 1))}" for name in names) + " }"
    return draw(scalars)


def _name(key: str) -> str:
    return next(iter(tomllib.loads(f"{key} = 0")))


def paths(value: Any, above: tuple[str, ...] = ()) -> set[tuple[str, ...]]:
    """All paths of a table."""
    inner: Mapping[str, Any] = value if isinstance(value, dict) else {}
    if isinstance(value, list):
        inner = {str(index): each for index, each in enumerate(value)}
    return {(*above, key) for key in inner} | {path for key in inner for path in paths(inner[key], (*above, key))}


def test_keys_are_where_they_are_written() -> None:
    _, places = read_toml(TEXT.encode(), "x")
    assert {path: places.of(tuple(path.split("/")))[1:] for path in PLACES} == PLACES
    assert places.of(("t", "v", "1", "w", "é")) == ("x", 14, 1)


@given(st.lists(st.tuples(keys, values()), max_size=4, unique_by=lambda pair: _name(pair[0])))
def test_all_keys_are_found_and_no_others(pairs: list[tuple[str, str]]) -> None:
    text = "".join(f"{key} = {value}\n" for key, value in pairs)
    assert {key.path for key in keys_in(text)} == paths(tomllib.loads(text))


@pytest.mark.parametrize(
    "text", ["a = 1\nb = [1 2]\n", "a = 1\nb", "a = 1\n[b", "a = 1\nb = {c = 1", 'a = 1\n"\\q" = 2']
)
def test_at_what_is_no_toml_it_stops(text: str) -> None:
    assert keys_in(text)[0] == TomlKey(0, ("a",), ())
    with pytest.raises(tomllib.TOMLDecodeError):
        tomllib.loads(text)


@pytest.mark.parametrize("nested", [lambda n: "x = " + "[" * n + "]" * n, lambda n: ".".join("a" * n) + " = 1"])
def test_the_limit_of_depth(nested: Any) -> None:
    assert keys_in(nested(MAX_DEPTH - 2))
    with pytest.raises(DepthError):
        keys_in(nested(MAX_DEPTH + 1))


BIOPSY = ROOT / "examples/biopsy/biopsy.toml"

HASH = "683b43326884"
"""Of the biopsy as the first versions wrote it, with `acts`: journals name it."""


def test_the_content_of_an_old_file_is_that_of_the_renamed_one() -> None:
    new = BIOPSY.read_text()
    old = new.replace("affects_patient = true", "acts = true")
    assert old != new
    assert parse_blueprint(old.encode()) == parse_blueprint(new.encode())
    assert parse_blueprint(new.encode()).hash.startswith(HASH)


def test_old_name_is_accepted_with_a_warning_naming_the_new_one() -> None:
    found = examine(PUMP.replace("%s", "acts = true").encode(), origin="pump.toml")
    assert found.sound
    assert [str(each) for each in found.warnings] == [
        "pump.toml:8:62: old_key: `acts` is now called `affects_patient`: rename it."
    ]
    assert not examine((PUMP % "affects_patient = true").encode()).warnings


def test_verify_shows_the_warning_and_reports_sound(tmp_path: Path) -> None:
    file = tmp_path / "pump.toml"
    file.write_text(PUMP % "acts = true")
    result = CliRunner().invoke(main, ["fsm", "verify", str(file)])
    assert (result.exit_code, "old_key" in result.stderr, "sound" in result.stdout) == (0, True, True)


def test_a_key_under_both_names_is_refused() -> None:
    with pytest.raises(BlueprintError, match="unknown field `acts`"):
        parse_blueprint((PUMP % "acts = true, affects_patient = false").encode())
