"""Signed peers with clocks: what was held back on its way has no effect, and answers are signed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from pcmrs.errors import PayloadError
from pcmrs.gateway.links import COUNTERS
from pcmrs.gateway.signing import Signer, read_key
from tests.unit.gateway.gateway_fakes import UdpClient, pass_look
from tests.unit.gateway.signed_room import Room, open_room, peer

FRESH = 2.0


@pytest.fixture
async def room(tmp_path: Path) -> AsyncIterator[Room]:
    peers = {"planner": peer(tmp_path, "planner", counter="unix_ns"), "panel": peer(tmp_path, "panel")}
    async with open_room(tmp_path, peers) as opened:
        opened.signers["planner"] = timed(opened)
        yield opened


def timed(room: Room, ahead: float = 0.0) -> Signer:
    """Signs with the time of a clock that is so many seconds ahead of the daemon's."""
    now: Callable[[], int] = lambda: int((room.clock.wall() + ahead) * 1e9)  # noqa: E731
    return Signer("planner", read_key(room.folder / "planner.key"), now, answers_signed=True)


async def answer(room: Room) -> str:
    """The next answer, whose signature holds."""
    return room.signers["planner"].check((await room.client.received.get()).encode()).decode()


def told(room: Room, reason: str) -> list[str]:
    return [event.text for event in room.core.events if event.fields.get("reason") == reason]


async def test_a_command_that_was_held_back_has_no_effect(room: Room) -> None:
    held = room.sign("execute_motionxx_#1;")
    await room.clock.advance(3600.0)
    room.client.send(held, room.planner)
    assert await answer(room) == "1_rejected_placement_retracted_too_old;"
    assert room.core.commands == []
    (text,) = told(room, "too_old")
    assert "'planner' is 3600.0 s old, the limit is 2 s" in text
    assert room.gateway.counters.of_peers["too_old"] == 1


async def test_the_same_bytes_move_the_arm_while_they_are_fresh(room: Room) -> None:
    held = room.sign("execute_motionxx_#1;")
    await room.clock.advance(FRESH - 0.01)
    await pass_look()
    room.client.send(held, room.planner)
    assert (await answer(room)).startswith("1_accepted")
    assert room.core.operations == ["approach"]


async def test_a_stop_that_was_held_back_stops(room: Room) -> None:
    held = room.sign("stop_now_xxxxxxx_#1;")
    await room.clock.advance(3600.0)
    room.client.send(held, room.planner)
    assert (await answer(room)).startswith("1_accepted")
    assert room.core.stops == ["peer:planner"]


async def test_clock_that_is_ahead_is_named_and_locks_nobody_out(room: Room, tmp_path: Path) -> None:
    """The times that a wrong clock has used must not keep out what the right one sends."""
    room.signers["planner"] = timed(room, ahead=3600.0)
    room.client.send(room.sign("execute_motionxx_#1;"), room.planner)
    assert await answer(room) == "1_rejected_placement_retracted_clock_ahead;"
    room.client.send(room.sign("stop_now_xxxxxxx_#2;"), room.planner)
    assert (await answer(room)).startswith("2_accepted")
    (text,) = told(room, "clock_ahead")
    assert "The clock of 'planner' is 3600.0 s ahead" in text
    assert room.core.commands == []

    room.signers["planner"] = timed(room)
    room.client.send(room.sign("execute_motionxx_#3;"), room.planner)
    assert (await answer(room)).startswith("3_accepted")
    assert room.core.operations == ["approach"]


async def test_command_sent_again_within_its_time_is_refused(room: Room) -> None:
    sent = room.sign("execute_motionxx_#1;")
    room.client.send(sent, room.planner)
    assert (await answer(room)).startswith("1_accepted")
    await room.hear(sent)
    assert room.gateway.counters.of_peers["old_counter"] == 1
    assert room.core.operations == ["approach"]


async def test_peer_without_timestamps_is_accepted_late(room: Room) -> None:
    held = room.sign("execute_motionxx_#1;", "panel")
    await room.clock.advance(3600.0)
    await pass_look()
    room.client.send(held, room.planner)
    assert await room.client.received.get() == "1_accepted_placement_retracted;"
    assert room.core.operations == ["approach"]


async def test_acknowledgement_and_second_datagram_are_signed(room: Room) -> None:
    room.core.results["register"] = {"residual": 0.0021}
    room.client.send(room.sign("start_registrati;"), room.planner)
    answers = [(await room.replies.received.get()).encode() for _ in range(2)]
    assert [room.signers["planner"].check(each) for each in answers] == [b"ack;", b"2.100000;"]


async def test_forged_answer_is_refused(room: Room) -> None:
    signer = room.signers["planner"]
    room.client.send(room.sign("get_jnt_angsxxxx_#1;"), room.planner)
    genuine = (await room.client.received.get()).encode()
    assert signer.check(genuine).startswith(b"1_accepted")
    for forged in (
        b"1_accepted_robot_1;",
        genuine.replace(b"1_accepted", b"2_accepted"),
        timed(room).sign(b"1_accepted_robot_1;"),
    ):
        with pytest.raises(PayloadError):
            signer.check(forged)
    room.signers["planner"] = timed(room)
    await room.clock.advance(1.0)
    room.sign("get_jnt_angsxxxx_#1;")
    with pytest.raises(PayloadError):
        room.signers["planner"].check(genuine)  # the answer to an earlier run of this client, with the same id


async def test_over_tcp_each_answer_is_a_frame(room: Room) -> None:
    reader, writer = await asyncio.open_connection(*room.tcp)
    writer.write(b"|;" + room.sign("get_jnt_angsxxxx;") + b";" + room.sign("execute_motionxx_#2;") + b";")
    answers = []
    for _ in range(3):
        text = await reader.readuntil(b";")
        answers.append(room.signers["planner"].check(text + (await reader.readuntil(b";"))[:-1]))
    assert b"ack;" in answers
    assert any(each.startswith(b"2_accepted") for each in answers)
    writer.close()


async def test_new_folder_is_reported_at_the_start(tmp_path: Path) -> None:
    """Commands that were kept would be taken once more: the counters begin at 0."""
    peers = {"planner": peer(tmp_path, "planner", counter="unix_ns"), "panel": peer(tmp_path, "panel")}
    async with open_room(tmp_path, peers) as room:
        (event,) = room.core.events
        assert event.code == "counters_reset"
        assert event.fields == {"peers": ["panel", "planner"]}
        assert f"{tmp_path / COUNTERS} is new" in event.text
        assert event.text.endswith("accepted again from: panel.")
    async with open_room(tmp_path, peers) as room:
        assert room.core.events == []
    (tmp_path / COUNTERS).unlink()
    async with open_room(tmp_path, {"planner": peers["planner"]}) as room:
        (event,) = room.core.events
        assert event.text.endswith("copy it from there.")


async def test_the_answer_goes_to_who_asks_from_another_port_too(room: Room) -> None:
    other = await UdpClient.open()
    other.send(room.sign("rob_conn_onxxxxx_#2;"), room.planner)
    assert room.signers["planner"].check((await other.received.get()).encode()).startswith(b"2_accepted")
    other.transport.close()
