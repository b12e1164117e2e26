"""Registration that decides, in a real daemon: refined over UDP, refused by name, and lost with a bumped reference."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.client import Client
from pcmrs.planner import Planner
from pcmrs.testing.driving import accept, landmarks, register, showing, until
from tests.system.daemon.daemon_process import PLAN, ServeProcess, own_settings, running_daemon

POINTS = 25


@pytest.mark.nightly
async def test_the_wire_refines_a_registration_by_the_surface(
    daemon: ServeProcess, client: Client, planner: Planner
) -> None:
    await planner.plan_landmarks([landmark["position"] for landmark in PLAN["landmarks"]])
    assert (await planner.command("icp_pointxxxxxxx")).reason == "invalid_in_state"
    await planner.digitize_all()
    for _ in range(3):
        assert (await planner.command("icp_pointxxxxxxx")).decision == "accepted"
    few = await planner.command("icp_registerxxxx", "/home/lab/skin_of_head/head_phantom.ply")
    assert (few.decision, few.reason) == ("rejected", "too_few_surface_points")
    assert (await planner.command("icp_clear_prevxx")).decision == "accepted"
    assert (await planner.command("icp_clear_allxxx")).decision == "accepted"
    assert (await planner.command("icp_clear_prevxx")).reason == "no_surface_points"
    await accept(client, "digitization.digitize_surface", points=POINTS)
    unknown = await planner.command("icp_registerxxxx", "/home/lab/nobody.ply")
    assert (unknown.decision, unknown.reason) == ("rejected", "unknown_surface")
    refined = await planner.command("icp_registerxxxx", "/home/lab/skin_of_head/head_phantom.ply")
    assert (refined.decision, refined.state, refined.results) == ("accepted", "111", ())


async def test_swapped_landmarks_are_named(daemon: ServeProcess, client: Client) -> None:
    await accept(client, "registration.plan_landmarks", **landmarks())
    first, second = (PLAN["landmarks"][index] for index in (0, 4))
    between = [b - a for a, b in zip(first["position"], second["position"], strict=True)]
    await client.request_device("scene", "displace_touch", {"index": 0, "offset_in_image": between})
    await client.request_device("scene", "displace_touch", {"index": 4, "offset_in_image": [-x for x in between]})
    await accept(client, "digitization.digitize_all")
    verdict = await client.call("registration.register", {})
    assert verdict.reason is not None
    assert verdict.reason.code == "swapped_landmarks"
    assert f"{first['name']} and {second['name']} are exchanged" in verdict.reason.text


@pytest.mark.nightly
async def test_bumped_reference_latches_and_learned_noise_is_kept(tmp_path: Path) -> None:
    """The next daemon uses the same noise."""
    settings = own_settings(tmp_path)
    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client:
            await register(client)
            await client.request_device(
                "scene", "bump_reference", {"offset_in_body_ref": [0.004, 0.0, 0.0], "rotvec": [0.0, 0.0, 0.0]}
            )
            await until(client, showing(registration="100", digitization="0"))
            await until(client, lambda snapshot: snapshot.latched)
            await accept(client, "robot.acknowledge")
            await accept(client, "digitization.digitize_all")
            again = await accept(client, "registration.register")
        assert "Traceback" not in daemon.log
    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client:
            await accept(client, "registration.plan_landmarks", **landmarks())
            await accept(client, "digitization.digitize_all")
            later = await accept(client, "registration.register")
        assert again.result is not None
        assert later.result is not None
        assert again.result["sigma"] != 0.00186
        assert later.result["sigma"] == again.result["sigma"]
        assert "Traceback" not in daemon.log
