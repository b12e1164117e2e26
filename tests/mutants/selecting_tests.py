"""The tests for a mutant: those that run what it changes, found in the map and never named by hand."""

from __future__ import annotations

import ast
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import msgspec

from tests.mutants.coverage_map import CoverageMap, MappedTest
from tests.mutants.places import DEFINITIONS, TOPS, Place

SLOWEST = 40.0
"""A test that takes longer than this (s, under coverage) is not chosen."""
QUICK = 2.0
"""Tests that take no longer (s, under coverage) come before the others: many of them fit into a limit."""


class Limits(msgspec.Struct, frozen=True):
    """Limits of what is tried on one mutant.

    Attributes:
        tests: Number of tests.
        seconds: Sum of their durations under coverage.
    """

    tests: int
    seconds: float


class Change(msgspec.Struct, frozen=True):
    """Lines that a mutant changes.

    Attributes:
        lines: First lines of the changed statements.
        body: Lines that are run when a changed condition holds, or an exception is caught: only a test that gets there
            can miss a removed guard.
    """

    lines: frozenset[int]
    body: frozenset[int]


def select(tree: Path, place: Place, coverage: CoverageMap, limits: Limits) -> list[str]:
    """Choose tests for a mutant.

    Quick tests come first. Among them, and then among the others, come first those that reach the guard's body; of what
    an import binds, such as the default of a setting, those whose id has its name. Then one instance of each test
    function comes before the second ones, then those in the folder of the package's tests, then the fastest.

    Args:
        tree: Root of the sources, unchanged.
        place: Text that the mutant changes.
        coverage: Map of these sources.
        limits: Limits of the choice.

    Returns:
        Node ids, in the order in which they should run.

    Raises:
        MapError: The map is of another source.
    """
    coverage.check(tree, place.file)
    change, module = changed(tree, place), ast.parse((tree / place.file).read_text())
    reaching = next(filter(None, (_reaching(coverage, each) for each in _circles(tree, place, change, module))), [])
    naming = _naming(coverage, _bound_by_import(module, change))
    tests = list({test.id: test for test in (*reaching, *naming)}.values())
    first = {test.id for test in naming or coverage.reaching(place.file, change.body)}
    package = own_tests(place.file)
    instances: Counter[str] = Counter()

    def rank(test: MappedTest) -> tuple[bool, bool, int, bool, float]:
        function = test.id.partition("[")[0]
        instances[function] += 1
        place = instances[function], not test.id.startswith(package), test.seconds
        return test.seconds > QUICK, test.id not in first, *place

    fast = sorted((test for test in tests if test.seconds <= SLOWEST), key=lambda test: test.seconds)
    ordered = sorted([(rank(test), test.id, test.seconds) for test in fast])[: limits.tests]
    sums = itertools.accumulate(seconds for _, _, seconds in ordered)
    return [name for (_, name, _), total in zip(ordered, sums, strict=True) if total <= limits.seconds]


def own_tests(file: Path) -> str:
    """Return the beginning of the ids of the tests that are named as the package of a file, or as the file itself.

    Args:
        file: File of the product, below the tree.
    """
    top, *folders = file.parent.parts
    if top in ("sim", "lab"):
        return f"tests/unit/{top}/"
    return f"tests/unit/{folders[0]}/" if folders else f"tests/unit/test_{file.stem}.py::"


def changed(tree: Path, place: Place) -> Change:
    """Find the lines of a changed text."""
    source = (tree / place.file).read_text()
    skipped = len(place.text) - len(place.text.lstrip())
    first = source.count("\n", 0, place.start + skipped) + 1
    last = source.count("\n", 0, place.start + len(place.text.rstrip())) + 1
    lines: set[int] = set()
    body: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.stmt | ast.ExceptHandler):
            continue
        header = range(node.lineno, _end_of_header(node) + 1)
        if header.start <= last and header.stop > first:
            lines.update(header)
            if isinstance(node, ast.If | ast.ExceptHandler):
                body.update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    return Change(frozenset(lines), frozenset(body))


def _circles(
    tree: Path, place: Place, change: Change, module: ast.Module
) -> Iterator[list[tuple[Path, Iterable[int]]]]:
    """Yield files and lines in ever wider circles round a change.

    Lines that an import runs belong to no test, nor do those in threads that are not traced: who uses the names that
    they bind stands for them, then their class, then their module.
    """
    around = _around(module, change)
    inner = max(around, key=lambda node: node.lineno, default=None)
    if inner is not None and not isinstance(inner, ast.ClassDef):
        if min(change.lines) >= inner.body[0].lineno:
            yield [(place.file, change.lines)]
        yield [(place.file, _function_lines(inner))]
    else:
        names = _bound_by_import(module, change)
        yield [(file, lines) for name in sorted(names) for file, lines in _users(tree, name)]
    for node in sorted(around, key=lambda node: -node.lineno):
        yield [(place.file, _function_lines(node))]
    yield [(place.file, _function_lines(module))]
    names = {node.name for node in module.body if isinstance(node, DEFINITIONS)}
    yield [(file, lines) for name in sorted(names) for file, lines in _users(tree, name)]


def _around(module: ast.Module, change: Change) -> list[ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef]:
    """Find the classes and functions that a change is in."""
    return [
        node for node in ast.walk(module)
        if isinstance(node, DEFINITIONS) and node.lineno <= min(change.lines) <= (node.end_lineno or 0)
    ]  # fmt: skip


def _bound_by_import(module: ast.Module, change: Change) -> set[str]:
    """Find the names that the changed statements bind in a module or class; none where they are in a function."""
    if any(not isinstance(node, ast.ClassDef) for node in _around(module, change)):
        return set()
    return {name for node in _statements(module) if node.lineno in change.lines for name in _bound(node)}


def _naming(coverage: CoverageMap, names: set[str]) -> list[MappedTest]:
    """Find the tests whose id has one of these, such as one instance for each default of a setting."""
    words = re.compile("|".join(rf"\b{re.escape(name)}\b" for name in sorted(names)) or r"(?!)")
    return [test for test in coverage.tests if words.search(test.id)]


def _reaching(coverage: CoverageMap, circle: Iterable[tuple[Path, Iterable[int]]]) -> list[MappedTest]:
    found = {test.id: test for file, lines in circle for test in coverage.reaching(file, lines)}
    return list(found.values())


def _users(tree: Path, name: str) -> list[tuple[Path, Iterable[int]]]:
    """Find the lines in functions of the product that name something."""
    found: list[tuple[Path, Iterable[int]]] = []
    word = re.compile(rf"\b{re.escape(name)}\b")
    for file, source, inside in _sources(tree):
        if name in source:
            lines = {number for number, line in enumerate(source.splitlines(), 1) if word.search(line)} & inside
            found.append((file, lines))
    return found


@lru_cache(maxsize=1)
def _sources(tree: Path) -> Sequence[tuple[Path, str, frozenset[int]]]:
    files = sorted(file for top in TOPS for file in (tree / top).rglob("*.py"))
    sources = [(file.relative_to(tree), file.read_text()) for file in files]
    return [(file, source, frozenset(_function_lines(ast.parse(source)))) for file, source in sources]


def _function_lines(node: ast.AST) -> set[int]:
    """Find the lines in the bodies of functions: a test runs them, an import does not."""
    return {
        line
        for function in ast.walk(node)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        for line in range(function.body[0].lineno, (function.end_lineno or 0) + 1)
    }


def _statements(module: ast.Module) -> Iterator[ast.stmt]:
    return (node for node in ast.walk(module) if isinstance(node, ast.stmt))


def _end_of_header(statement: ast.stmt | ast.ExceptHandler) -> int:
    """Find the last line of a statement, or of an ``except``, without the statements in it."""
    inner = [*getattr(statement, "body", ()), *(case.body[0] for case in getattr(statement, "cases", ()))]
    ends = [max(node.lineno - 1, statement.lineno) for node in inner if isinstance(node, ast.stmt)]
    return min([statement.end_lineno or 0, *ends])


def _bound(statement: ast.stmt) -> Iterator[str]:
    """Yield the names that a statement of a module or class binds."""
    if isinstance(statement, DEFINITIONS):
        yield statement.name
    for node in ast.walk(statement) if isinstance(statement, ast.Assign | ast.AnnAssign) else ():
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
