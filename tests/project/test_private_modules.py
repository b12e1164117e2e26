"""A module of the product that only its own package uses begins with an underscore, and no other module does."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from importlib.metadata import distributions
from pathlib import Path

import grimp
import pytest

from tests import ROOT

DISTRIBUTIONS = ("pcmrs", "pcmrs_sim", "pcmrs_lab")
PROGRAMS = ("benchmarks", "deploy", "docs", "examples", "fuzz")
"""Folders whose programs may import what is public."""
BY_NAME = ("pcmrs.cli", "pcmrs.devices.drivers", "pcmrs.testing")
"""Packages whose modules are commands and drivers, found by their names, or helpers for users."""


@cache
def imports() -> grimp.ImportGraph:
    return grimp.build_graph(*DISTRIBUTIONS)


def package_of(module: str) -> str:
    return module.rpartition(".")[0]


def is_private(module: str) -> bool:
    return module.rpartition(".")[2].startswith("_")


def importers_elsewhere(module: str) -> set[str]:
    """Modules that import a module and are outside its package."""
    package = package_of(module)
    found = imports().find_modules_that_directly_import(module)
    return {each for each in found if each != package and not each.startswith(f"{package}.")}


def imported_by_programs() -> Iterator[str]:
    """Names that programs and examples in documents import; a name may be a module or something in it."""
    for folder in PROGRAMS:
        for file in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text())):
                if isinstance(node, ast.Import):
                    yield from (alias.name for alias in node.names)
                elif isinstance(node, ast.ImportFrom) and node.module:
                    yield node.module
                    yield from (f"{node.module}.{alias.name}" for alias in node.names)
    for page in (ROOT / "docs").rglob("*.md"):
        yield from re.findall(r"^\s*(?:from|import) (pcmrs[\w.]*)", page.read_text(), re.MULTILINE)


def found_by_name() -> Iterator[str]:
    """Modules that entry points name, that are started with ``python -m``, or that a blueprint has beside it."""
    points = (point for distribution in distributions() for point in distribution.entry_points)
    yield from (point.module for point in points if point.module.startswith(DISTRIBUTIONS))
    for module in imports().modules:
        path = Path(*module.split("."))
        for file in (ROOT / folder / path.with_suffix(".py") for folder in (".", "sim", "lab")):
            if file.with_suffix(".toml").is_file():
                yield module
            if file.is_file():
                yield from re.findall(r'"(pcmrs[\w.]+)"', file.read_text())


@pytest.fixture(scope="module")
def modules() -> list[str]:
    """Modules of the product's packages; a package itself is no module here."""
    graph = imports()
    found = [each for each in graph.modules if each.startswith("pcmrs.") and not graph.find_children(each)]
    return sorted(each for each in found if package_of(each) != "pcmrs" and not each.endswith("__main__"))


def test_private_modules_are_used_by_their_own_package_only(modules: list[str]) -> None:
    wrong = {each: importers_elsewhere(each) for each in modules if is_private(each)}
    assert {each: who for each, who in wrong.items() if who} == {}
    ours = [each for each in imported_by_programs() if each.startswith(DISTRIBUTIONS)]
    assert [each for each in ours if "._" in each] == []


def test_a_module_that_only_its_package_uses_is_private(modules: list[str]) -> None:
    known = {*imported_by_programs(), *found_by_name()}
    public = [each for each in modules if not is_private(each) and package_of(each) not in BY_NAME]
    public = [each for each in public if not each.startswith(tuple(f"{package}." for package in BY_NAME))]
    assert [each for each in public if each not in known and not importers_elsewhere(each)] == []
