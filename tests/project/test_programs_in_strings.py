"""Programs that tests and examples hold in strings import only names that exist; no type checker looks into strings."""

from __future__ import annotations

import ast
import importlib
import textwrap
from collections.abc import Iterator
from pathlib import Path

from tests import ROOT

FOLDERS = ("tests", "examples", "benchmarks", "fuzz", "lab", "sim", "pcmrs")
PACKAGES = ("pcmrs", "pcmrs_sim", "pcmrs_lab", "tests")


def imports(program: str) -> Iterator[tuple[str, str]]:
    """Yield module and name of each import of our packages in a text; nothing if it is not a program."""
    try:
        tree = ast.parse(textwrap.dedent(program))
    except (SyntaxError, ValueError):
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in PACKAGES:
            yield from ((node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name.split(".")[0] in PACKAGES)


def programs(file: Path) -> Iterator[str]:
    """Yield the texts of a file that import one of our packages."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and "import " in node.value:
            yield node.value


def is_missing(module: str, name: str) -> bool:
    """Return whether a module, or a name in it, does not exist."""
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError as error:
        return (error.name or "").split(".")[0] in PACKAGES
    if not name or hasattr(found, name):
        return False
    try:
        importlib.import_module(f"{module}.{name}")
    except ModuleNotFoundError:
        return True
    return False


def found() -> set[tuple[str, str, str]]:
    """Return file, module and name of all imports in programs of files that start a Python."""
    files = (file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py"))
    return {
        (str(file.relative_to(ROOT)), module, name)
        for file in files
        if "sys.executable" in file.read_text()
        for program in programs(file)
        for module, name in imports(program)
    }


def test_imports_of_a_program_in_a_string_exist() -> None:
    imported = found()
    files = {file for file, _, _ in imported}
    assert "tests/system/network/remote_cell.py" in files
    assert [each for each in sorted(imported) if is_missing(*each[1:])] == []


def test_names_that_do_not_exist_are_found() -> None:
    assert is_missing("pcmrs.clock", "NoSuchClock")
    assert is_missing("pcmrs.no_such_module", "")
    assert not is_missing("pcmrs", "clock")
    assert not is_missing("pcmrs.clock", "")
