"""Tests: `unit` by module, `system` of whole cells, `project` of the repository, `nightly` and `mutants` as tools."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
"""Folder of the repository."""

TESTS = ROOT / "tests"
