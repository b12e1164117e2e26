"""A daemon whose nodes are delayed by the laboratory is ready only when it can release all of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.testing.cell import LIGHT
from pcmrs_lab.campaign.delays import Delays, Rule
from tests.system.daemon.daemon_process import own_settings, running_daemon


async def test_daemon_is_ready_only_when_all_actors_can_be_released(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    delays = Delays(tmp_path / "delays")
    for name, value in delays.install().items():
        monkeypatch.setenv(name, value)
    first_beats = Rule("publish", "dev/stimulator/beat", seconds=2.0, times=40)
    async with delays.delaying(first_beats, ended=False):
        with running_daemon([*own_settings(tmp_path), *LIGHT, "cell.rate=1"], tmp_path) as daemon:
            async with daemon.client() as client:
                connected = await client.call("robot.connect")
                assert connected.decision == "accepted"
                assert "still_latched" not in (connected.result or {})
