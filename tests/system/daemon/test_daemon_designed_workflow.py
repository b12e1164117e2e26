"""Workflows designed from step tables are run: Stop bars what reaches the patient until it is released."""

from __future__ import annotations

from pathlib import Path

from pcmrs.authoring.design import design
from pcmrs.messages import Beat, DeviceEvent
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.driving import accept, acknowledge
from pcmrs.testing.simulated import CellInSimulatedTime, run_simulated
from tests import ROOT
from tests.system.daemon.daemon_process import own_settings, running_daemon

TABLE = ROOT / "examples/biopsy_steps.toml"
BY_HAND = b"""
id = "injection_steps"
version = "1.0.0"
title = "Injection by hand"

[[steps]]
name = "planned"
operation = "plan_site"
moves = false

[[steps]]
name = "injected"
operation = "inject"
depends_on = ["planned"]
affects_patient = true
"""


def test_steps_at_the_patient_wait_for_the_release_in_the_hint(tmp_path: Path) -> None:
    workflow = tmp_path / "biopsy_steps.toml"
    workflow.write_text(design(TABLE.read_bytes()).text)

    async def course(cell: CellInSimulatedTime) -> None:
        for operation in ("robot.connect", "procedure.register", "procedure.plan_path", "procedure.align"):
            await cell.accept(operation)
        cell._link.publish("stop/nurse", Beat(number=0, session="", alive=0.0, sent=0.0))
        await cell.until(lambda shown: shown.latched and not shown.stop.pending)
        for barred in ("align", "insert", "take_sample"):
            refused = (await cell.call(f"procedure.{barred}")).reason
            assert refused is not None
            assert refused.code == "latched"
            assert "safety.acknowledge" in refused.text
        await cell.accept("safety.acknowledge")
        for operation in ("insert_confirmation.confirm_insert", "procedure.insert", "procedure.take_sample"):
            await cell.accept(operation)
        await cell.accept("procedure.make_safe")
        await cell.accept("procedure.align")
        assert (await cell.call("procedure.insert")).decision == "rejected"

    run_simulated(course, str(workflow), LIGHT)


async def test_workflow_without_a_robot_is_abandoned_and_released(tmp_path: Path) -> None:
    """What is in the patient is a danger when nobody attends to it; no robot is there to confirm that it stands."""
    workflow = tmp_path / "injection_steps.toml"
    workflow.write_text(design(BY_HAND).text)
    no_devices = [f"{device}.driver=none" for device in ("robot", "tracker", "pointer", "scene", "stimulator", "emg")]
    settings = [*own_settings(tmp_path), f"workflow={workflow}", *no_devices, "procedure.abandoned_after=3"]
    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client:
            assert "pcmrs call safety.acknowledge" in daemon.pcmrs("stop").stdout
            assert (await acknowledge(client)).decision == "accepted"
            for operation in ("procedure.plan_site", "procedure.inject"):
                await accept(client, operation)
            async for event in client.watch():
                if isinstance(event, DeviceEvent) and event.code == "session_abandoned":
                    assert "safety.acknowledge" in event.text
                    break
            stopped = (await client.state()).stop.number
            assert await client.standstill(stopped)
            assert (await acknowledge(client)).decision == "accepted"
            await accept(client, "procedure.make_safe")
            assert not (await client.state()).latched
        assert daemon.end() == 0
