"""Signed commands over real sockets: what is authentic acts once, what is not leaves no trace on the wire."""

from __future__ import annotations

import asyncio
import random
from pathlib import Path
from typing import Any

import pytest

from pcmrs.gateway.commands import DEFAULT
from pcmrs.gateway.signing import Signer
from pcmrs.planner import Planner
from pcmrs.testing.clock import settle
from tests.unit.gateway.signed_room import Room, open_room, peer, refused, signer, told


async def test_a_signed_command_acts_in_the_name_of_its_peer(room: Room) -> None:
    assert await room.ask("execute_motionxx_#1;") == "1_accepted_placement_retracted;"
    (command,) = room.core.commands
    assert (command.operation, command.source) == ("approach", "peer:planner")


@pytest.mark.parametrize("command", ["stop_now_xxxxxxx;", "get_jnt_angsxxxx_#1;", "__msg_toolpose_1_2_3_4_5_6"])
async def test_unsigned_on_an_exposed_link_is_refused_without_answer(room: Room, command: str) -> None:
    await room.hear(command.encode())
    assert (await room.ask("get_jnt_angsxxxx_#9;")).startswith("9_accepted")
    assert room.unanswered
    assert room.gateway.counters.refused == 1
    assert room.core.stops == []


async def test_signed_tool_points_reach_the_planner_once(tmp_path: Path) -> None:
    headset, shows = peer(tmp_path, "headset", allow=("plan",)), "__msg_toolpose_1_2_3_4_5_6.5"
    peers = {"headset": headset, "planner": peer(tmp_path, "planner", allow=("read",))}
    async with open_room(tmp_path, peers, stream=True) as room:
        points = room.sign(f"{shows};", "headset")
        await room.hear(points)
        assert (await room.client.received.get()) == "__msg_toolpose_1.00000_2.00000_3.00000_4.00000_5.00000_6.50000"
        await room.hear(points)
        await room.hear(room.sign(f"{shows};", "planner"))
        assert (await room.ask("get_jnt_angsxxxx_#9;")).startswith("9_accepted")
        assert room.unanswered
        assert {"old_counter", "not_allowed"} <= told(room)


async def test_each_failure_has_its_reason_and_no_answer(room: Room, tmp_path: Path) -> None:
    good = room.sign("rob_conn_onxxxxx_#1;")
    peer(tmp_path, "stranger")
    for data, reason in (
        (good[:-1] + (b"0" if good[-1:] != b"0" else b"1"), "bad_tag"),
        (signer(tmp_path, "stranger").sign(b"rob_conn_onxxxxx_#1;"), "unknown_peer"),
    ):
        await room.hear(data)
        assert room.gateway.counters.of_peers[reason] == 1
        assert reason in told(room)
    room.client.send(good, room.planner)
    assert (await room.client.received.get()).startswith("1_accepted")
    await room.hear(good)
    assert room.gateway.counters.of_peers["old_counter"] == 1
    assert "old_counter" in told(room)
    assert room.core.operations == ["connect"]
    assert room.unanswered
    assert room.gateway.counters.table()["gateway.bad_tag"] == 1


async def test_reordered_command_is_refused(room: Room) -> None:
    first, second, third = (room.sign(f"rob_conn_onxxxxx_#{number};") for number in (1, 2, 3))
    for data in (second, first, third):
        await room.hear(data)
    assert {(await room.client.received.get())[:10] for _ in range(2)} == {"2_accepted", "3_accepted"}
    assert len(room.core.commands) == 2
    assert room.gateway.counters.of_peers["old_counter"] == 1
    assert room.unanswered


async def test_of_many_forged_datagrams_none_is_taken_or_answered(room: Room) -> None:
    await forge(room, 20_000)


@pytest.mark.nightly
@pytest.mark.timeout(3600)
async def test_of_a_million_forged_datagrams_none_is_taken_or_answered(room: Room) -> None:
    await forge(room, 1_000_000)


async def forge(room: Room, many: int) -> None:
    """Datagrams of somebody who knows names and grammar, has seen one signed Stop, and has no key."""
    draw = random.Random(7)
    seen = room.sign("stop_now_xxxxxxx;")
    for number in range(1, many + 1):
        claimed = draw.choice(("planner", "panel", "nobody"))
        counter = draw.choice((number, 2**63 - 1, draw.randrange(1, 10**19)))
        tag = draw.choice((seen[-32:], b"%032x" % draw.getrandbits(128), b"0" * 32))
        command = draw.choice((b"stop_now_xxxxxxx;", b"execute_motionxx_#1;", b"get_jnt_angsxxxx_#2;"))
        forged = b"%s|%s|%d|%s" % (command, claimed.encode(), counter, tag)
        room.client.send(seen[:-1] + b"?" if forged == seen else forged, room.planner)
        if number % 64 == 0 or number == many:
            while room.gateway.counters.received < number:
                await settle()
    counters = room.gateway.counters
    assert (counters.received, counters.refused) == (many, many)
    assert counters.of_peers["bad_tag"] > many // 2
    assert (room.core.stops, room.core.commands) == ([], [])
    assert (await room.ask("get_jnt_angsxxxx_#9;")).startswith("9_accepted")
    assert room.unanswered
    assert len(refused(room)) <= 2  # one for each reason: time stands still


async def test_a_peer_may_do_what_is_listed_and_always_stop(tmp_path: Path) -> None:
    planner = peer(tmp_path, "planner", allow=("read", "plan"))
    async with open_room(tmp_path, {"planner": planner}) as room:
        assert (await room.ask("get_jnt_angsxxxx_#1;")).startswith("1_accepted")
        assert await room.ask("execute_homexxxx_#2;") == "2_rejected_placement_retracted_not_allowed;"
        assert (await room.ask("stop_now_xxxxxxx_#3;")).startswith("3_accepted")
        assert room.core.commands == []
        assert room.core.stops == ["peer:planner"]
        assert room.gateway.counters.of_peers["not_allowed"] == 1
        assert "not_allowed" in told(room)


async def test_only_a_peer_that_may_treat_speaks_for_the_surgeon(tmp_path: Path) -> None:
    peers = {
        "planner": peer(tmp_path, "planner", allow=DEFAULT),
        "listed": peer(tmp_path, "listed", allow=("session_reinitxx", "grid_performxxxx")),
        "panel": peer(tmp_path, "panel", allow=(*DEFAULT, "treat")),
    }
    async with open_room(tmp_path, peers, surgeon="A. Surgeon") as room:
        room.core.branches["treatment"] = "unknown"
        for name in ("planner", "listed"):
            assert (await room.ask("session_reinitxx_#1;", name)).endswith("_not_allowed;")
        assert room.core.commands == []
        assert any('"treat" in gateway.peers.planner.allow' in event.text for event in room.core.events)
        assert (await room.ask("session_reinitxx_#1;", "panel")).startswith("1_accepted")
        (command,) = room.core.commands
        assert (command.operation, command.arguments) == ("confirm_clear", {"surgeon": "A. Surgeon"})
        room.core.branches["treatment"] = "ready"
        assert (await room.ask("session_reinitxx_#2;")).startswith("2_accepted"), "nothing is stated then"


async def test_daemon_gets_the_user_and_role_of_a_peer(tmp_path: Path) -> None:
    peers = {"planner": peer(tmp_path, "planner"), "panel": peer(tmp_path, "panel", role="operator")}
    async with open_room(tmp_path, peers) as room:
        for name in peers:
            await room.ask("rob_conn_onxxxxx_#1;", name)
        asked = [(each.user, each.role) for each in room.core.commands]
        assert asked == [("planner", "planner"), ("panel", "operator")]


async def test_a_peer_over_its_rate_is_rejected_but_for_stop(tmp_path: Path) -> None:
    planner = peer(tmp_path, "planner", rate=2.0, burst=3)
    async with open_room(tmp_path, {"planner": planner, "panel": peer(tmp_path, "panel")}) as room:
        replies = [await room.ask(f"get_jnt_angsxxxx_#{number};") for number in range(5)]
        assert [reply.split("_")[1] for reply in replies] == ["accepted"] * 3 + ["rejected"] * 2
        assert replies[4] == "4_rejected_robot_1_over_rate;"
        for number in range(10, 30):
            assert (await room.ask(f"stop_now_xxxxxxx_#{number};")).startswith(f"{number}_accepted")
        assert len(room.core.stops) == 20
        assert (await room.ask("get_jnt_angsxxxx_#1;", "panel")).startswith("1_accepted")
        await room.clock.advance(0.5)
        assert (await room.ask("get_jnt_angsxxxx_#31;")).startswith("31_accepted")
        assert (await room.ask("get_jnt_angsxxxx_#32;")).endswith("over_rate;")
        await room.clock.advance(3600.0)  # it holds no more than its burst, however long nothing came
        replies = [await room.ask(f"get_jnt_angsxxxx_#{number};") for number in range(40, 44)]
        assert [reply.split("_")[1] for reply in replies] == ["accepted"] * 3 + ["rejected"]
        assert room.gateway.counters.of_peers["over_rate"] == 4


async def test_performed_command_is_never_answered_rejected(tmp_path: Path) -> None:
    """A command that is sent again over the rate has been performed; saying anything else would have it sent anew."""
    async with open_room(tmp_path, {"planner": peer(tmp_path, "planner", rate=0.001, burst=1)}) as room:
        assert (await room.ask("rob_conn_onxxxxx_#1;")).startswith("1_accepted")
        assert (await room.ask("rob_conn_onxxxxx_#1;")).startswith("1_accepted")
        assert room.core.operations == ["connect"]


@pytest.mark.parametrize("part", ["target_rotxxxxxx_0_0_0_1", "target_tslxxxxxx_0_0_0", "img_fid_numxxxxx_03"])
async def test_a_part_of_a_plan_that_is_denied_holds_motion_back(tmp_path: Path, part: str) -> None:
    async with open_room(tmp_path, {"planner": peer(tmp_path, "planner", allow=("motion",))}) as room:
        assert (await room.ask(f"{part}_#1;")).endswith("not_allowed;")
        assert (await room.ask("execute_motionxx_#2;")).endswith("plan_not_accepted;")
        assert room.core.commands == []


@pytest.mark.parametrize(
    ("begin", "denied", "end", "reason"),
    [
        ("target_rotxxxxxx_0_0_0_1", "target_rotxxxxxx_0_0_1_0", "target_tslxxxxxx_0_0_0", "no_rotation"),
        ("img_fid_numxxxxx_02", "img_fid_numxxxxx_01", "img_fid_pntxxxxx_00_0_0_0", "no_series"),
    ],
)
async def test_a_part_of_a_plan_that_is_denied_drops_what_came_before(
    tmp_path: Path, begin: str, denied: str, end: str, reason: str
) -> None:
    """Or else the old half would be joined to what follows."""
    async with open_room(tmp_path, {"planner": peer(tmp_path, "planner", rate=2.0, burst=1)}) as room:
        assert (await room.ask(f"{begin}_#1;")).startswith("1_accepted")
        assert (await room.ask(f"{denied}_#2;")).endswith("over_rate;")
        await room.clock.advance(0.5)
        assert (await room.ask(f"{end}_#3;")).endswith(f"{reason};")


async def test_two_peers_of_one_host_share_nothing(room: Room) -> None:
    await room.ask("target_rotxxxxxx_0_0_0_1_#1;")
    await room.ask("img_fid_numxxxxx_01_#2;")
    assert (await room.ask("target_tslxxxxxx_0_0_0_#1;", "panel")).endswith("no_rotation;")
    assert (await room.ask("img_fid_pntxxxxx_00_0_0_0_#2;", "panel")).endswith("no_series;")
    # The panel's broken plan holds the panel back, not the planner once its own is whole.
    assert (await room.ask("target_tslxxxxxx_0_0_0_#3;")).startswith("3_accepted")
    assert (await room.ask("img_fid_pntxxxxx_00_0_0_0_#4;")).startswith("4_accepted")
    assert (await room.ask("img_fid_lastrecv_#5;")).startswith("5_accepted")
    assert (await room.ask("execute_motionxx_#6;")).startswith("6_accepted")
    assert (await room.ask("execute_motionxx_#6;", "panel")).endswith("plan_not_accepted;")


async def test_unsigned_local_clients_work_beside_peers(tmp_path: Path) -> None:
    async with open_room(tmp_path, {"planner": peer(tmp_path, "planner")}, host="127.0.0.1") as room:
        room.client.send("get_jnt_angsxxxx_#1;", room.planner)
        assert (await room.client.received.get()).startswith("1_accepted")
        assert (await room.ask("rob_conn_onxxxxx_#1;")).startswith("1_accepted")
        assert room.core.commands[0].source == "peer:planner"


async def test_without_peers_what_is_signed_is_refused(tmp_path: Path) -> None:
    peer(tmp_path, "planner")
    async with open_room(tmp_path, {}, host="127.0.0.1") as room:
        await room.hear(room.sign("stop_now_xxxxxxx;"))
        assert room.gateway.counters.of_peers["unknown_peer"] == 1
        assert room.core.stops == []
        assert not (tmp_path / "peers.counters").exists()


async def test_the_planner_signs_when_it_has_a_key(room: Room, tmp_path: Path) -> None:
    async with await Planner.open(*room.planner, signer=signer(tmp_path, "planner")) as planner:
        await planner.connect()
        await planner.plan_pose([0.1, 0.2, 0.3], [0.0, 0.0, 0.0, 1.0])
        await planner.approach()
        await planner.stop()
    assert room.core.operations == ["connect", "plan", "approach"]
    assert room.core.stops == ["peer:planner"]


async def test_planner_with_a_key_signs_each_repetition(room: Room, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcmrs.planner.REPEAT_AFTER", 0.01)
    room.core.gates["connect"].clear()
    async with await Planner.open(*room.planner, signer=signer(room.folder, "planner")) as planner:
        answer = asyncio.ensure_future(planner.command("rob_conn_onxxxxx"))
        while room.gateway.counters.received < 3:
            await settle()
        room.core.open_gates()
        assert (await answer).decision == "accepted"
    assert room.core.operations == ["connect"]
    assert room.gateway.counters.refused == 0


async def test_secrets_are_neither_in_settings_nor_in_events(room: Room, tmp_path: Path) -> None:
    secret = (tmp_path / "planner.key").read_text().strip()
    await room.hear(Signer("planner", bytes(32)).sign(b"stop_now_xxxxxxx;"))
    said: Any = (room.core.events, peer(tmp_path, "planner"))
    assert "bad_tag" in told(room)
    assert secret not in repr(said)
