"""Defaults of safety settings stand a second time in a table: whoever loosens one has to say so there."""

from __future__ import annotations

import tomllib
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.settings import Settings
from tests import ROOT

TABLE = tomllib.loads(Path(__file__).with_name("safety_defaults.toml").read_text())
NOTES = ("requirement", "source")
EXPECTED = {name: value for group in TABLE["defaults"] for name, value in group.items() if name not in NOTES}
OTHERS = [pattern for group in TABLE["others"] for pattern in group["settings"]]


def flat(settings: msgspec.Struct, prefix: str = "") -> dict[str, Any]:
    """Name to value of every setting, with structures in structures as dotted names."""
    found: dict[str, Any] = {}
    for name in settings.__struct_fields__:
        value = getattr(settings, name)
        if isinstance(value, msgspec.Struct):
            found |= flat(value, f"{prefix}{name}.")
        else:
            found[prefix + name] = list(value) if isinstance(value, tuple) else value
    return found


PRESENT = flat(Settings())


@pytest.mark.parametrize("name", EXPECTED)
def test_the_default_of_a_safety_setting_is_the_one_in_the_table(name: str) -> None:
    assert PRESENT[name] == EXPECTED[name]


def test_every_setting_is_in_the_table_or_excluded_with_a_reason() -> None:
    """The reason says why it is no safety setting."""
    unknown = [name for name in PRESENT if name not in EXPECTED and not any(fnmatchcase(name, each) for each in OTHERS)]
    assert unknown == []


def test_the_table_names_no_setting_that_there_is_not() -> None:
    assert [name for name in EXPECTED if name not in PRESENT] == []
    assert [each for each in OTHERS if not any(fnmatchcase(name, each) for name in PRESENT)] == []


@pytest.mark.parametrize("group", TABLE["defaults"], ids=lambda group: group["requirement"])
def test_group_of_the_table_has_a_requirement_and_a_page(group: dict[str, Any]) -> None:
    assert f"| {group['requirement']} |" in (ROOT / "docs" / "safety.md").read_text()
    assert (ROOT / group["source"]).exists()
