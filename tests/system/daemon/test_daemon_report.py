"""The report of a session that a real daemon has recorded, exported, and of what was changed in the export."""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.client import Client
from pcmrs.messages import Verdict
from pcmrs.testing.cell import QUICK
from pcmrs.testing.daemon import own_settings, running_daemon
from pcmrs.testing.driving import acknowledge, landmarks, tool_pose
from tests.unit.report.report_page import Page

PLACEMENTS, REFUSALS = 9, 7
"""Columns of the tables."""
PASSING = ("pose_missing", "pose_stale", "busy")
"""Reasons that pass by themselves on a machine that is busy."""


async def told(client: Client, name: str, arguments: dict[str, Any] | None = None) -> Verdict:
    for _ in range(20):
        verdict = await client.call(name, arguments or {}, timeout=60.0)
        if verdict.reason is None or verdict.reason.code not in PASSING:
            return verdict
        await asyncio.sleep(0.5)
    return verdict


async def located(client: Client) -> None:
    """The robot is looked for once it has connected."""
    while (await client.state()).branches["placement"] == "unknown":
        await told(client, "placement.locate")


async def treated(client: Client) -> dict[str, Verdict]:
    """Refused without landmarks, placed twice, stopped, acknowledged, brought home."""
    found = {"refused": await told(client, "registration.register")}
    await told(client, "registration.plan_landmarks", landmarks())
    await told(client, "digitization.digitize_all")
    found["registered"] = await told(client, "registration.register")
    await told(client, "toolplan.plan", tool_pose())
    await told(client, "robot.connect")
    await located(client)
    for number in range(2):
        await told(client, "placement.approach")
        found[f"placed {number}"] = await told(client, "placement.confirm")
        await told(client, "placement.back_off")
    await client.stop()
    await acknowledge(client)
    found["home"] = await told(client, "placement.home")
    return found


def run(*words: object) -> tuple[int, str]:
    result = CliRunner().invoke(main, list(map(str, words)))
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout


@pytest.mark.nightly
def test_exported_session_is_reported_with_its_file_hashes(tmp_path: Path) -> None:
    cell = tmp_path / "cell"
    cell.mkdir()
    own = [each for each in own_settings(cell, f"report-{os.getpid()}") if not each.startswith("recording.")]
    settings = [*own, *QUICK, "procedure.patient=P-017", "procedure.body.surface=", "procedure.operator=Dr Hand"]

    async def session() -> dict[str, Verdict]:
        async with (
            running_daemon(settings, tmp_path / "log") as daemon,
            Client.connect(daemon.ready.endpoint, cell=daemon.ready.prefix.split("/")[-1]) as client,
        ):
            return await treated(client)

    found = asyncio.run(session())
    folder, output = tmp_path / "session", tmp_path / "page.html"
    words = [word for each in settings for word in ("--set", each)]
    assert run("export-session", "-o", folder, *words)[0] == 0
    status, out = run("report", folder, "-o", output, "--pdf", tmp_path / "page.pdf", "--json")
    report, page = json.loads(out), Page(output.read_text())
    assert (status, report["known"], report["latched"], report["unknown"]) == (0, True, False, [])
    assert [run["in_order"] for run in report["runs"]] == [True]

    assert (page.value("Patient"), page.value("Operator")) == ("P-017", "Dr Hand")
    assert "Robotic transcranial magnetic stimulation · patient P-017" in page.words
    assert page.value("Journal").startswith("verified: whole, and signed")
    residual = (found["registered"].result or {})["residual"]
    assert f"Registration, mean residual {1000.0 * residual:.2f} mm" in page.words
    errors = [(found[f"placed {number}"].result or {})["translation_error"] for number in range(2)]
    assert [cells[7] for cells in page.rows(PLACEMENTS)] == [f"{1000.0 * error:.3f}" for error in errors]
    refused = [cells for cells in page.rows(REFUSALS) if cells[2].startswith("registration.register")]
    assert found["refused"].reason is not None
    assert found["refused"].reason.text in refused[0][5]
    assert "robot: connected" in page.words
    for name in ("journal.sqlite", "journal.sqlite.head", "journal.pub"):
        assert [name, hashlib.sha256((folder / name).read_bytes()).hexdigest()] == next(
            [cells[0], cells[2]] for cells in page.cells if cells[0] == name
        )
    assert any(file["name"].endswith(".mcap") for file in report["files"])

    assert run("report", cell, "-o", tmp_path / "cell.html")[0] == 0
    (folder / "configuration.toml").write_text("changed")
    status, _ = run("report", folder, "-o", output)
    assert status == 1
    assert "configuration.toml differs from SHA256SUMS." in Page(output.read_text()).words
