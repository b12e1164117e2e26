"""Rows before a daemon starts: a library that was exchanged, and a certificate that would be valid everywhere."""

from __future__ import annotations

import zipfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from pcmrs.clock import SystemClock
from pcmrs.pki import Authority
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.faults import supply
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run


class Pip:
    """An installer that compares hashes, as pip does; or does not."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, compares: bool = True) -> None:
        self._compares = compares
        monkeypatch.setattr(supply, "ended", self.ended)

    async def ended(self, words: list[str]) -> tuple[int, str]:
        return self._install(dict(pairwise(words)))

    def _install(self, given: dict[str, str]) -> tuple[int, str]:
        wheel = Path(given["--find-links"]) / supply.WHEEL
        offered = supply._digest(wheel)
        if "--requirement" in given:
            lock = Path(given["--requirement"]).read_text()
            if offered not in lock and self._compares:
                return 1, f"Expected {lock.partition('sha256:')[2].strip()}, got {offered}."
        into = Path(given["--target"])
        into.mkdir()
        with zipfile.ZipFile(wheel) as packed:
            (into / "harmless.py").write_bytes(packed.read("harmless.py"))
        return 0, "Installed."


def exchanged(monkeypatch: pytest.MonkeyPatch, folder: Path) -> Any:
    return run(monkeypatch, supply.exchanged_library(lab_of(folder, OperatedCell())))


def test_an_exchanged_wheel_is_not_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    Pip(monkeypatch)
    found = exchanged(monkeypatch, tmp_path)
    assert proves(found)
    assert found.took_place["sha256_locked"] != found.took_place["sha256_offered"]
    assert found.control == {"installed_without_hashes": "kind = 'another one'"}
    assert (tmp_path / "first" / "harmless.py").read_text() == "kind = 'the locked one'\n"


def test_an_installer_that_compares_nothing_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    Pip(monkeypatch, compares=False)
    with pytest.raises(Unmet, match="pip ended with 0"):
        exchanged(monkeypatch, tmp_path)


def test_a_wheel_that_was_not_exchanged_is_found_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    Pip(monkeypatch)
    with sham(), pytest.raises(Unmet, match="was not exchanged"):
        exchanged(monkeypatch, tmp_path)


def test_a_wheel_has_what_an_installer_needs(tmp_path: Path) -> None:
    supply._make_wheel(tmp_path / supply.WHEEL, "kind = 'x'\n")
    with zipfile.ZipFile(tmp_path / supply.WHEEL) as wheel:
        assert set(wheel.namelist()) == {"harmless.py", *(f"harmless-1.0.dist-info/{name}" for name in supply.METADATA)}


class Issuer:
    """The command that issues certificates."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, asks_for_cells: bool = True) -> None:
        self.words: list[list[str]] = []
        self._asks = asks_for_cells
        monkeypatch.setattr(supply, "ended", self.ended)

    async def ended(self, words: list[str]) -> tuple[int, str]:
        self.words.append(words)
        if "--cell" not in words and self._asks:
            return 2, "Usage: ...\nError: Missing option '--cell'.\n"
        given = dict(pairwise(words))
        cells = (given["--cell"],) if "--cell" in given else ("*/*",)
        authority = Authority(Path(given["--folder"]))
        authority.issue("operator", "anna", SystemClock().wall(), cells=cells, into=Path(given["--output"]))
        return 0, "Issued."


def issued(monkeypatch: pytest.MonkeyPatch, folder: Path) -> Any:
    return run(monkeypatch, supply.certificate_for_no_cell(lab_of(folder, OperatedCell())))


def test_a_certificate_is_issued_for_a_cell_only(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    Issuer(monkeypatch)
    found = issued(monkeypatch, tmp_path)
    assert proves(found)
    assert found.took_place == {"said_without_a_cell": "Error: Missing option '--cell'."}
    assert found.control == {"issued_for": "lab/cell1"}


def test_a_certificate_for_every_cell_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    Issuer(monkeypatch, asks_for_cells=False)
    with pytest.raises(Unmet, match="Without a cell pcmrs pki issue ended with 0"):
        issued(monkeypatch, tmp_path)


def test_a_cell_that_was_given_is_found_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    Issuer(monkeypatch)
    with sham(), pytest.raises(Unmet, match="ended with 0"):
        issued(monkeypatch, tmp_path)


async def test_only_the_end_of_an_output_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    async def ended(_: list[str]) -> tuple[int, str]:
        return 1, "x" * 1000 + "the end"

    monkeypatch.setattr(supply, "ended", ended)
    status, text = await supply._run("pip")
    assert (status, len(text)) == (1, 300)
    assert text.endswith("the end")
