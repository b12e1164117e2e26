"""Entry points are read once, and again when packages can be found elsewhere."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.installed import entry_points_of


def _install(folder: Path, package: str, text: str) -> None:
    information = folder / f"{package}-1.0.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(text)


def test_points_of_a_group_are_those_of_all_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    group = "pcmrs.of_this_test"
    assert entry_points_of(group) == []
    _install(tmp_path, "first", f"[{group}]\na = one:open\n[another]\nb = one:open\n")
    _install(tmp_path, "second", f"[{group}]\nc = two:open\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert {point.name: point.value for point in entry_points_of(group)} == {"a": "one:open", "c": "two:open"}


def test_package_counts_where_python_finds_it_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    group = "pcmrs.of_that_test"
    _install(tmp_path / "hidden", "same", f"[{group}]\na = hidden:open\n")
    _install(tmp_path / "seen", "same", f"[{group}]\na = seen:open\n")
    monkeypatch.syspath_prepend(tmp_path / "hidden")
    monkeypatch.syspath_prepend(tmp_path / "seen")
    assert [point.value for point in entry_points_of(group)] == ["seen:open"]
