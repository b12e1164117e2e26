"""A biopsy designed from a step table runs as a daemon: Stop bars what reaches the patient until it is released."""

from __future__ import annotations

from pathlib import Path

from daemon_process import own_settings, running_daemon

from pcmrs.campaign.driving import accept
from pcmrs.fsm.design import design

TABLE = Path(__file__).parents[2] / "examples/biopsy_steps.toml"


async def test_what_reaches_the_patient_waits_for_the_release_that_the_hint_names(tmp_path: Path) -> None:
    workflow = tmp_path / "biopsy_steps.toml"
    workflow.write_text(design(TABLE.read_bytes()).text)
    settings = [*own_settings(tmp_path), f"workflow={workflow}"]
    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client:
            for operation in ("robot.connect", "procedure.register", "procedure.plan_path", "procedure.align"):
                await accept(client, operation)
            assert "pcmrs call safety.acknowledge" in daemon.pcmrs("stop").stdout
            for barred in ("align", "insert", "take_sample"):
                refused = (await client.call(f"procedure.{barred}")).reason
                assert refused is not None
                assert refused.code == "latched"
                assert "safety.acknowledge" in refused.text
            assert (await client.acknowledge()).decision == "accepted"
            for operation in ("insert_confirmation.confirm_insert", "procedure.insert", "procedure.take_sample"):
                await accept(client, operation)
            await accept(client, "procedure.make_safe")
            await accept(client, "procedure.align")
            assert (await client.call("procedure.insert")).decision == "rejected"
        assert daemon.end() == 0
