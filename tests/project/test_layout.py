"""The tests of a module are found by its name: `pcmrs/bus/seal.py` in `tests/unit/bus/test_seal.py`."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import ROOT, TESTS
from tests.support.documents import DOCS, documents

PACKAGES = {"pcmrs": ROOT / "pcmrs", "sim": ROOT / "sim" / "pcmrs_sim", "lab": ROOT / "lab" / "pcmrs_lab"}
SHARE = 0.95
"""Least share of the modules with behaviour of each package that have a unit test file."""
FOLDERS = "unit|system|project|mutants|nightly|support"
"""Folders below ``tests``, as a regular expression."""


def behaves(module: Path) -> bool:
    """Return whether a module contains a function that does something; protocols and tables only declare."""
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            last = node.body[-1]
            if not isinstance(last, ast.Expr) or not isinstance(last.value, ast.Constant):
                return True
    return False


def unit_test(package: str, module: Path) -> Path:
    """Return the file that holds the unit tests of a module."""
    below = module.relative_to(PACKAGES[package]).parent
    return (
        TESTS / "unit" / (below if package == "pcmrs" else Path(package) / below) / f"test_{module.stem.lstrip('_')}.py"
    )


def modules(package: str) -> list[Path]:
    found = PACKAGES[package].rglob("*.py")
    return sorted(path for path in found if path.stem not in ("__init__", "__main__") and behaves(path))


def missing_paths(text: str) -> list[str]:
    """Return the paths below ``tests`` that a text names and that do not exist; ``*`` stands for any name.

    A path in backquotes may leave out ``tests/``.
    """
    named = re.findall(r"\btests/[\w./*-]*\w", text)
    named += [f"tests/{path}" for path in re.findall(rf"`((?:{FOLDERS})/[\w./*-]*\w)", text)]
    return [path for path in named if not any(ROOT.glob(path))]


def test_pages_name_only_files_and_folders_of_tests_that_exist() -> None:
    pages = [*documents(), *(DOCS / "adr").glob("*.md")]
    missing = {page.name: missing_paths(page.read_text()) for page in pages}
    assert {name: paths for name, paths in missing.items() if paths} == {}
    assert missing_paths(
        "`pytest tests/unit tests/journal`, `tests/unit/b*s`, `tests/no_*.py`, `unit/no.py`, unit/no"
    ) == [
        "tests/journal",
        "tests/no_*.py",
        "tests/unit/no.py",
    ]


def test_architecture_names_modules_of_dispatcher_and_service() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    for package in ("pcmrs/dispatcher", "pcmrs/service"):
        table = re.search(rf"^\| [^|]*`{package}` \|[^\n]*\n(?:\|.*\n)+", page, re.MULTILINE)
        assert table is not None
        named = set(re.findall(r"`(\w+(?:\.py|/))`", table[0]))
        there = {path.name if path.is_file() else f"{path.name}/" for path in (ROOT / package).iterdir()}
        assert named == there - {"__init__.py", "__pycache__/"}


def imported(program: str) -> Iterator[str]:
    """Yield the modules that a program imports, and `tests.a.b` for each name `b` that it imports from `tests.a`."""
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def is_of_laboratory(module: str) -> bool:
    """Return whether a module is the laboratory or one of its tests."""
    return re.match(r"(pcmrs_lab|tests\.(unit|system)\.lab)(\.|$)", module) is not None


def test_tests_of_the_product_do_not_use_the_laboratory() -> None:
    own = ("unit/lab", "system/lab", "project", "mutants", "nightly")
    tests = {path.relative_to(TESTS).as_posix(): path for path in TESTS.rglob("*.py")}
    others = {name: path for name, path in tests.items() if not name.startswith(own)}
    using = [name for name, path in others.items() if any(map(is_of_laboratory, imported(path.read_text())))]
    assert len(others) > 500
    assert using == []


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("import pcmrs_lab.campaign as campaign", True),
        ("from tests.unit import lab", True),
        ("from tests.system.lab.record_golden import record", True),
        ("from tests.unit.labels import LABELS", False),
        ("from pcmrs.testing.natlab import nat_lab", False),
    ],
)
def test_an_import_of_the_laboratory_is_found(line: str, expected: bool) -> None:
    assert any(map(is_of_laboratory, imported(line))) is expected


@pytest.mark.parametrize("package", PACKAGES)
def test_modules_have_unit_tests_of_their_name(package: str) -> None:
    tests = {path: unit_test(package, path) for path in modules(package)}
    missing = {path: test for path, test in tests.items() if not test.is_file()}
    names = "\n".join(f"{path.relative_to(ROOT)}: {test.relative_to(ROOT)}" for path, test in missing.items())
    assert 1 - len(missing) / len(tests) >= SHARE, f"modules without unit tests:\n{names}"
