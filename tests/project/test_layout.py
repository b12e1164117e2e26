"""The tests of a module are found by its name: `pcmrs/bus/seal.py` in `tests/unit/bus/test_seal.py`."""

from __future__ import annotations

import ast
from pathlib import Path

from tests import ROOT, TESTS

PACKAGES = {"pcmrs": ROOT / "pcmrs", "sim": ROOT / "sim" / "pcmrs_sim"}
SHARE = 0.95
"""Least share of the modules with behaviour that have a unit test file."""


def behaves(module: Path) -> bool:
    """Return whether a module contains a function that does something; protocols and tables only declare."""
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            last = node.body[-1]
            if not isinstance(last, ast.Expr) or not isinstance(last.value, ast.Constant):
                return True
    return False


def unit_test(module: Path) -> Path:
    """Return the file that holds the unit tests of a module."""
    name, folder = next((name, folder) for name, folder in PACKAGES.items() if module.is_relative_to(folder))
    below = module.relative_to(folder).parent
    return TESTS / "unit" / (below if name == "pcmrs" else Path(name) / below) / f"test_{module.stem.lstrip('_')}.py"


def modules() -> list[Path]:
    found = (path for folder in PACKAGES.values() for path in folder.rglob("*.py"))
    return sorted(path for path in found if path.stem not in ("__init__", "__main__") and behaves(path))


def test_modules_have_unit_tests_of_their_name() -> None:
    missing = [path for path in modules() if not unit_test(path).is_file()]
    names = "\n".join(f"{path.relative_to(ROOT)}: {unit_test(path).relative_to(ROOT)}" for path in missing)
    assert 1 - len(missing) / len(modules()) >= SHARE, f"modules without unit tests:\n{names}"
