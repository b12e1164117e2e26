"""Rows of an account on the cell's machine: nobody else may read the daemon's files, nor be named like people there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign import without_guard
from pcmrs_lab.campaign.fault import Evidence
from pcmrs_lab.campaign.faults import local_account
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, proves, run
from tests.unit.lab.campaign.scripted_cell import ScriptedLab

PEERS = "gateway.peers."
"""Prefix of the settings that name peers."""
FILES = ("ratms.sqlite", "ratms.sqlite-wal", "ratms.sqlite.head", "journal.key", "journal.pub")


class Shell(ScriptedLab):
    """A lab whose daemon writes its files with these modes, and whose shell writes its own with the given umask."""

    def __init__(self, folder: Path, mode: int = 0o600, *, files: tuple[str, ...] = FILES) -> None:
        cell = OperatedCell(folder / "open")
        super().__init__(folder, cell)
        self.unguarded = OperatedCell(folder / "unguarded")
        self._mode, self._files = mode, files

    def daemon(self, *overrides: str, **given: Any) -> Any:
        place, words = given["folder"], given["prefix"][2]
        mode = 0o644 if without_guard.PROGRAM in given["prefix"] else self._mode
        if mode != 0o644:
            place.chmod(0o700)
        for name in self._files:
            (place / name).write_bytes(b"x")
            (place / name).chmod(mode)
        probe = self.folder / "probe"
        probe.write_bytes(b"")
        probe.chmod(0o600 if "umask 077" in words else 0o644)
        return super().daemon(*overrides, **given)


def opened(monkeypatch: pytest.MonkeyPatch, lab: ScriptedLab) -> Evidence:
    return run(monkeypatch, local_account.open_folder(lab.as_lab))


def test_only_the_owner_may_read_the_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = opened(monkeypatch, Shell(tmp_path))
    assert proves(found)
    assert found.took_place == {"mode_of_the_folder_before": "0755"}
    assert found.control["mode_of_a_file_of_the_shell"] == "0644"
    assert set(found.control["others_may_read_without_the_guard"]) == set(FILES)
    assert set(found.details["files"]) == {"open", *FILES}


@pytest.mark.parametrize(
    ("mode", "files", "text"),
    [
        (0o640, FILES, r"Others may use \{.*'ratms.sqlite': '0640'"),
        (0o600, FILES[:1], r"Only open, ratms\.sqlite were checked"),
    ],
)
def test_a_folder_that_proves_nothing_is_a_finding(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, mode: int, files: tuple[str, ...], text: str
) -> None:
    with pytest.raises(Unmet, match=text):
        opened(monkeypatch, Shell(tmp_path, mode, files=files))


def test_a_shell_that_lets_nobody_read_is_found_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with sham(), pytest.raises(Unmet, match="did not let others read"):
        opened(monkeypatch, Shell(tmp_path))


LOCAL = "Error: local is the name of the operators on site.\n"
ANNA = "Error: gateway.peers holds 'anna', and the register has 'anna'.\n"
OTHER = "Error: the key cannot be read.\n"


@pytest.mark.parametrize(
    ("of_a_member", "status", "errors", "names"),
    [
        (False, 4, LOCAL, ["local", "locals"]),
        (False, 0, LOCAL, None),
        (False, 4, OTHER, None),
        (False, 4, "Traceback\nError: local\n", None),
        (False, 4, "", None),
        (True, 4, ANNA, ["anna", "another"]),
        (True, 0, ANNA, None),
        (True, 4, OTHER, None),
        (True, 4, "", None),
    ],
)
def test_a_peer_with_the_name_of_a_person_is_refused(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    of_a_member: bool,
    status: int,
    errors: str,
    names: list[str] | None,
) -> None:
    lab = ScriptedLab(tmp_path, OperatedCell())
    lab.refusals = [(status, errors)]
    work = local_account.peer_named_as_a_member if of_a_member else local_account.peer_named_local
    if names is None:
        with pytest.raises(Unmet, match=f"It ended with {status}"):
            run(monkeypatch, work(lab.as_lab))
        return
    found = run(monkeypatch, work(lab.as_lab))
    assert proves(found)
    assert found.took_place == {"said_of_the_name": errors.strip()}
    named = [setting.split(".")[2] for settings in lab.started for setting in settings if setting.startswith(PEERS)]
    assert named == names
