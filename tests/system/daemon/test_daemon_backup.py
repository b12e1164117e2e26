"""A cell of the first version, upgraded and run; backed up while it runs; restored, and run again."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.client import Client
from pcmrs.errors import DeviceError
from pcmrs.journal import JournalReader, JournalRow, verify
from pcmrs.testing.daemon import DaemonProcess, own_settings, running_daemon
from pcmrs.testing.daemon import device_key as key_of
from tests import ROOT
from tests.unit.maintenance.labs import Lab, unpacked

pytest.importorskip("mujoco")

pytestmark = pytest.mark.timeout(600)


def pcmrs(*words: object) -> dict[str, Any]:
    """Run a command, and return its JSON."""
    command = [sys.executable, "-m", "pcmrs.cli", *map(str, words), "--json"]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    found: dict[str, Any] = msgspec.json.decode(ended.stdout)
    return found


def settings(lab: Lab, folder: Path) -> list[str]:
    """Settings of a daemon in a folder, with the lab's calibration of the pointer."""
    return [*own_settings(folder, "cell1"), f"procedure.calibration.pointer_file={lab.folder / 'pointer.toml'}"]


def client_of(daemon: DaemonProcess, folder: Path) -> Any:
    return Client.connect(daemon.ready.endpoint, cell="cell1", device_key=key_of(folder))


def events(journal: Path) -> list[JournalRow]:
    with JournalReader(journal) as reader:
        return [stored.row for stored in reader.read(kind="event", source="journal")]


async def test_a_cell_lives_on_through_upgrade_backup_and_restore(tmp_path: Path) -> None:
    lab, log = unpacked("first", tmp_path), tmp_path / "log"
    with pytest.raises(DeviceError, match="pcmrs upgrade --check"):
        async with running_daemon(settings(lab, lab.cell), log):
            pytest.fail("It runs in the folder of the first version.")
    pcmrs("upgrade", lab.cell)

    copy, restored = tmp_path / "copy", tmp_path / "restored"
    async with running_daemon(settings(lab, lab.cell), log) as daemon, client_of(daemon, lab.cell) as client:
        assert (await client.call("robot.connect")).decision == "accepted"
        assert (await client.state()).latched is False
        backed_up = pcmrs("backup", copy, *words(settings(lab, lab.cell)))
        assert (await client.call("robot.disconnect")).decision == "accepted"
    assert verify(lab.journal).sound
    rows = backed_up["manifest"]["journals"]["ratms.sqlite"]["rows"]
    assert 0 < rows < verify(lab.journal).rows

    pcmrs("restore", copy, restored)
    async with running_daemon(settings(lab, restored), log) as daemon, client_of(daemon, restored) as client:
        state = await client.state()
        assert state.latched
        refused = await client.call("placement.home")
        assert refused.decision == "rejected"
        assert (await client.call("robot.connect")).decision == "accepted"
    journal = restored / "ratms.sqlite"
    found = verify(journal)
    assert (found.problems, found.unnamed) == ((), 0)
    (note,) = [row for row in events(journal) if row.operation == "restored"]
    assert (note.result or {})["rows"] == rows


def words(overrides: list[str]) -> list[str]:
    return [word for override in overrides for word in ("--set", override)]
