from __future__ import annotations

from pcmrs.client import Client
from pcmrs.planner import Planner
from tests.system.daemon.daemon_process import PLAN, ServeProcess


async def test_an_external_planner_completes_the_procedure_over_udp(
    daemon: ServeProcess, planner: Planner, client: Client
) -> None:
    await planner.connect()
    await planner.plan_landmarks([landmark["position"] for landmark in PLAN["landmarks"]])
    await planner.digitize_all()
    assert 0.1 < await planner.register() < 4.0
    for pose in PLAN["poses"][:2]:
        await planner.plan_pose(pose["position"], pose["quat_xyzw"])
        await planner.approach()
        placed = await planner.confirm()
        assert placed.translation_error_mm < 0.5
        assert placed.rotation_error_deg < 0.2
        await planner.back_off()
        await planner.home()
    branches = (await client.state()).branches
    assert branches["registration"] == "111"
    assert branches["placement"] == "retracted"
