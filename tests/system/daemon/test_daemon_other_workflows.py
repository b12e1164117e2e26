"""Daemons of workflows from outside the package: one without a robot, and one that changes under its journal."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import CommandRefusedError
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.driving import accept, register
from pcmrs.workflows import find_workflow
from tests import ROOT
from tests.system.daemon.daemon_process import PLAN, as_words, own_settings, run_pcmrs, running_daemon

BIOPSY = ROOT / "examples" / "biopsy" / "biopsy.toml"


async def test_a_workflow_of_two_branches_without_a_robot(tmp_path: Path) -> None:
    with running_daemon([*own_settings(tmp_path), *LIGHT, f"workflow={BIOPSY}"], tmp_path) as daemon:
        assert daemon.ready.workflow == "biopsy 1.0.0"
        assert Path(daemon.ready.journal) == tmp_path / "biopsy.sqlite"
        async with daemon.client() as client, daemon.planner() as planner:
            await planner.plan_landmarks([landmark["position"] for landmark in PLAN["landmarks"]])
            await accept(client, "registration.digitize_all")
            assert 0.1 < await planner.register() < 4.0
            for refused in (planner.connect(), planner.approach(), planner.digitize_all()):
                with pytest.raises(CommandRefusedError, match="unknown_branch"):
                    await refused
            with pytest.raises(CommandRefusedError, match="unknown_branch"):
                await planner.plan_pose(PLAN["poses"][0]["position"], PLAN["poses"][0]["quat_xyzw"])
            await accept(client, "needle.plan_path", entry=[0.01, 0.02, 0.12], target=[0.01, 0.02, 0.05])
            assert (await accept(client, "needle.insert")).state == "at_target"
            await planner.stop()
            await accept(client, "needle.sample")
            assert (await accept(client, "needle.withdraw")).state == "out"
        assert daemon.end() == 0
        assert "Traceback" not in daemon.log


@pytest.mark.nightly
async def test_changed_workflow_needs_a_migration_to_reuse_a_journal(tmp_path: Path) -> None:
    workflow = tmp_path / "mine.toml"
    shipped = find_workflow("ratms").blueprint.read_text()
    workflow.write_text(shipped)
    settings = [*own_settings(tmp_path / "cell"), f"workflow={workflow}"]
    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client:
            await register(client)
    workflow.write_text(f"# A comment changes nothing.\n{shipped}")
    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client:
            await accept(client, "registration.use_previous")
    changed = shipped.replace("timeout_s = 300", "timeout_s = 200")
    assert changed != shipped
    workflow.write_text(changed)
    refused = run_pcmrs("serve", *as_words(settings))
    assert refused.returncode == 4, refused.stderr
    assert "Traceback" not in refused.stderr
    for word in ("ratms 1.4.0", str(workflow), "pcmrs fsm diff", "[[migrations]]", "cell.folder"):
        assert word in refused.stderr
    table = refused.stderr[refused.stderr.index("[[migrations]]") :].split("\n\n")[0]
    workflow.write_text(f"{changed}\n{table}\n")
    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client:
            await accept(client, "registration.use_previous")
        assert "Traceback" not in daemon.log
