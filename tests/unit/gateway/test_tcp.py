"""The TCP link: frames of a stream, what ends a connection, and how many there may be."""

from __future__ import annotations

import asyncio
import socket
import struct
from pathlib import Path
from typing import Any

import pytest
import uvloop
from hypothesis import example, given
from hypothesis import strategies as st

from pcmrs.errors import PayloadError
from pcmrs.gateway.commands import COMMANDS
from pcmrs.gateway.grammar import MAX_BYTES
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.settings import GatewayConfig, LinkConfig
from pcmrs.gateway.tcp import FIRST_WITHIN, MOST, MOST_OF_A_HOST, Frames
from pcmrs.testing.clock import ManualClock, settle
from tests.unit.gateway.gateway_fakes import WITHIN, FakeCore, rest_of
from tests.unit.gateway.signed_room import Room, open_room, peer

CONNECT = b"rob_conn_onxxxxx_#1;"


STOP = b"stop_now_xxxxxxx;"


PAGES = {
    "a page's fetch": b"POST / HTTP/1.1\r\nHost: 127.0.0.1:8058\r\nContent-Type: text/plain\r\n\r\n;" + CONNECT,
    "a page's form": b"POST /;" + CONNECT + b" HTTP/1.1\r\n\r\n",
    "a line that begins as a command does": b"rob_conn\r\n;" + CONNECT,
    "a name that there is not": b"rob_conn_off_now;" + CONNECT,
    "a token too many": b"rob_conn_onxxxxx_1_2;" + CONNECT,
    "bytes without an end": b"x" * 1000 + b";" + CONNECT,
    "TLS": b"\x16\x03\x01\x02\x00\x01;" + CONNECT,
}
"""Sent by whom, and what; each holds a command that would be taken by itself."""


frames = st.sampled_from([CONNECT, STOP, b"start_registrati;", b"target_tslxxxxxx_1.5_-2_3e-1_#77;"])


pieces = st.lists(st.integers(1, 40), max_size=40)


def cut(stream: bytes, sizes: list[int]) -> list[bytes]:
    parts = []
    for size in sizes:
        parts.append(stream[:size])
        stream = stream[size:]
    return [*parts, stream]


def taken(parts: list[bytes]) -> list[bytes]:
    """Frames of the parts, until the grammar breaks."""
    stream, found = Frames(), []
    try:
        for part in parts:
            for frame in stream.feed(part):
                found.append(frame)
    except PayloadError:
        pass
    return found


@given(st.lists(frames), pieces)
def test_frames_do_not_depend_on_segments(sent: list[bytes], sizes: list[int]) -> None:
    assert taken(cut(b"".join(sent), sizes)) == sent


@given(st.lists(frames), pieces, st.integers(1, 10**18))
@example([CONNECT], [1] * 40, 1)
def test_a_signed_stream_has_a_signature_in_each_frame(sent: list[bytes], sizes: list[int], counter: int) -> None:
    signed = [each + b"|planner|%d|" % counter + b"0f" * 16 for each in sent]
    assert taken(cut(b"|;" + b"".join(each + b";" for each in signed), sizes)) == signed


@given(st.lists(frames, max_size=3), st.binary(min_size=1, max_size=80), pieces)
def test_nothing_after_the_first_wrong_byte_is_a_frame(before: list[bytes], wrong: bytes, sizes: list[int]) -> None:
    found = taken(cut(b"".join(before) + b"\n" + wrong + b";" + CONNECT, sizes))
    assert found == before


def test_every_command_may_come_byte_by_byte() -> None:
    for name in COMMANDS:
        assert taken([bytes([byte]) for byte in f"{name};".encode()]) == [f"{name};".encode()]


def test_there_is_no_tcp_link_unless_it_is_configured() -> None:
    assert GatewayConfig().tcp_port is None


async def test_tcp_takes_split_and_merged_segments(cell: Any) -> None:
    cell.core.results["register"] = {"residual": 0.0023}
    reader, writer = await asyncio.open_connection(*cell.gateway.addresses["tcp"])
    for part in (b"rob_conn_", b"onxxxxx_#1;rob_conn_onxxxxx;start_re", b"gistrati;"):
        writer.write(part)
        await writer.drain()
    answers = [(await reader.readuntil(b";")).decode() for _ in range(4)]
    assert sorted(answers) == sorted(["1_accepted_robot_1;", "ack;", "ack;", "2.300000;"])
    assert answers.index("ack;") < answers.index("2.300000;")
    writer.close()


@pytest.mark.parametrize("sent", PAGES.values(), ids=PAGES.keys())
async def test_broken_grammar_ends_the_connection_at_once(cell: Any, sent: bytes) -> None:
    """Nothing after it is read."""
    reader, writer = await asyncio.open_connection(*cell.gateway.addresses["tcp"])
    writer.write(sent)
    try:
        answer = await rest_of(reader)
    except ConnectionResetError:  # bytes were left unread
        answer = b""
    writer.close()
    assert answer == b""
    assert cell.core.commands == []
    assert cell.gateway.counters.refused == 1
    again, writer = await asyncio.open_connection(*cell.gateway.addresses["tcp"])
    writer.write(CONNECT)  # the same bytes, where they are permitted
    assert await again.readuntil(b";") == b"1_accepted_robot_1;"
    writer.close()


async def test_a_command_without_an_end_fills_no_memory(cell: Any) -> None:
    reader, writer = await asyncio.open_connection(*cell.gateway.addresses["tcp"])
    writer.write(b"icp_registerxxxx_" + b"a" * MAX_BYTES)
    assert await rest_of(reader) == b""
    writer.close()
    assert cell.gateway.counters.refused == 1


async def test_a_stop_before_the_wrong_byte_is_honoured(cell: Any) -> None:
    reader, writer = await asyncio.open_connection(*cell.gateway.addresses["tcp"])
    writer.write(STOP + b"\r\n" + CONNECT)
    await rest_of(reader)
    writer.close()
    assert len(cell.core.stops) == 1
    assert cell.core.commands == []


async def is_served(address: tuple[str, int], opened: list[asyncio.StreamWriter]) -> bool:
    """Whether a new connection is answered; it stays open until its writer in `opened` is closed."""
    reader, writer = await asyncio.open_connection(*address)
    opened.append(writer)
    writer.write(CONNECT)
    try:
        return await reader.readuntil(b";") == b"1_accepted_robot_1;"
    except (ConnectionResetError, asyncio.IncompleteReadError):
        return False


async def test_connections_per_host_are_limited_until_one_ends(cell: Any) -> None:
    address, opened = cell.gateway.addresses["tcp"], list[asyncio.StreamWriter]()
    assert [await is_served(address, opened) for _ in range(MOST_OF_A_HOST + 1)] == [*[True] * MOST_OF_A_HOST, False]
    assert cell.gateway.counters.refused == 1
    opened[0].close()
    async with asyncio.timeout(WITHIN):
        while not await is_served(address, opened):
            pass
    for each in opened:
        each.close()


async def test_connections_of_all_hosts_together_are_limited(cell: Any) -> None:
    """Those of 127.0.0.2 and its like must sign, and are silent."""
    address, opened = cell.gateway.addresses["tcp"], list[asyncio.StreamWriter]()
    hosts = [f"127.0.0.{2 + number // MOST_OF_A_HOST}" for number in range(MOST)]
    silent = [(await asyncio.open_connection(*address, local_addr=(host, 0)))[1] for host in hosts]
    assert not await is_served(address, opened)
    assert cell.gateway.counters.refused == 1
    silent[0].close()
    async with asyncio.timeout(WITHIN):
        while not await is_served(address, opened):
            pass
    for each in (*silent, *opened):
        each.close()


def test_connection_reset_before_it_is_taken_disturbs_nobody(tmp_path: Path) -> None:
    """In uvloop, in which the daemon runs, it has no address any more."""

    async def serve() -> None:
        troubles: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, trouble: troubles.append(trouble))
        links = GatewayConfig(
            planner=LinkConfig(), robot=LinkConfig(), visualization=LinkConfig(), mep=LinkConfig(), tcp_port=0
        )
        async with open_gateway(FakeCore(), links, ManualClock(), tmp_path) as gateway:
            for _ in range(MOST_OF_A_HOST + 1):
                with socket.create_connection(gateway.addresses["tcp"]) as gone:
                    gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            opened = list[asyncio.StreamWriter]()
            assert await is_served(gateway.addresses["tcp"], opened)
            opened[0].close()
            assert gateway.counters.refused == 0
        assert troubles == []

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(serve())


async def test_silent_peer_that_must_sign_loses_its_connection(tmp_path: Path) -> None:
    async with open_room(tmp_path, {"planner": peer(tmp_path, "planner")}, host="0.0.0.0") as room:
        reader, writer = await asyncio.open_connection(*room.tcp)
        signed, signed_writer = await asyncio.open_connection(*room.tcp)
        signed_writer.write(b"|;" + room.sign("rob_conn_onxxxxx_#1;") + b";")
        assert (await signed.readuntil(b";")).startswith(b"1_accepted")
        writer.write(b"|;")
        await settle()
        await room.clock.advance(FIRST_WITHIN + 1.0)
        assert await rest_of(reader) == b""
        signed_writer.write(room.sign("rob_conn_onxxxxx_#2;") + b";")
        assert (await signed.readuntil(b";")).startswith(b"2_accepted")
        assert room.gateway.counters.refused == 1
        for each in (writer, signed_writer):
            each.close()


async def test_a_silent_client_of_this_machine_stays(cell: Any) -> None:
    """A panel with a button for Stop sends nothing until it is pressed."""
    reader, writer = await asyncio.open_connection(*cell.gateway.addresses["tcp"])
    await settle()
    cell.clock.expire(FIRST_WITHIN)
    await settle()
    writer.write(b"stop_now_xxxxxxx_#1;")
    assert (await reader.readuntil(b";")).startswith(b"1_accepted")
    writer.close()


async def test_a_tcp_client_that_does_not_read_is_read_from_no_more(cell: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    room = asyncio.Event()

    async def drain(_writer: asyncio.StreamWriter) -> None:
        await room.wait()

    monkeypatch.setattr(asyncio.StreamWriter, "drain", drain)
    reader, writer = await asyncio.open_connection(*cell.gateway.addresses["tcp"])
    writer.write(b"get_jnt_angsxxxx_#1;get_jnt_angsxxxx_#2;")
    assert (await reader.readuntil(b";")).startswith(b"1_accepted")
    await settle()
    assert cell.gateway.counters.received == 1
    room.set()
    assert (await reader.readuntil(b";")).startswith(b"2_accepted")
    writer.close()


async def test_a_connection_that_begins_so_signs(room: Room) -> None:
    reader, writer = await asyncio.open_connection(*room.tcp)
    writer.write(b"|;" + room.sign("rob_conn_onxxxxx_#1;") + b";" + room.sign("execute_motionxx_#2;") + b";")
    replies = {(await reader.readuntil(b";"))[:10] for _ in range(2)}
    assert replies == {b"1_accepted", b"2_accepted"}
    assert [command.source for command in room.core.commands] == ["peer:planner"] * 2
    writer.close()


async def test_a_signed_frame_may_come_byte_by_byte(room: Room) -> None:
    reader, writer = await asyncio.open_connection(*room.tcp)
    for byte in b"|;" + room.sign("rob_conn_onxxxxx_#1;") + b";":
        writer.write(bytes([byte]))
        await writer.drain()
        await asyncio.sleep(0)
    assert (await reader.readuntil(b";")).startswith(b"1_accepted")
    writer.close()


async def test_forged_tcp_frame_is_not_answered_and_the_next_one_is(room: Room) -> None:
    forged = room.sign("stop_now_xxxxxxx;")[:-32] + b"0" * 32
    reader, writer = await asyncio.open_connection(*room.tcp)
    writer.write(b"|;" + forged + b";" + room.sign("rob_conn_onxxxxx_#1;") + b";")
    assert (await reader.readuntil(b";")).startswith(b"1_accepted")
    assert room.core.stops == []
    assert room.gateway.counters.of_peers["bad_tag"] == 1
    writer.close()


async def test_unsigned_command_ends_a_connection_that_signs(room: Room) -> None:
    reader, writer = await asyncio.open_connection(*room.tcp)
    writer.write(b"|;" + b"stop_now_xxxxxxx;" * 2)
    assert await rest_of(reader) == b""
    assert room.core.stops == []
    assert room.gateway.counters.refused == 1
    writer.close()


@pytest.mark.parametrize("cut", [1, 30, 45])
async def test_a_signature_that_is_cut_off_is_refused(room: Room, cut: int) -> None:
    reader, writer = await asyncio.open_connection(*room.tcp)
    writer.write((b"|;" + room.sign("stop_now_xxxxxxx;") + b";")[:-cut])
    writer.write_eof()
    assert await rest_of(reader) == b""
    assert room.core.stops == []
    assert room.gateway.counters.refused == 1
    writer.close()


async def test_tcp_signatures_without_the_opening_end_the_connection(tmp_path: Path) -> None:
    """On loopback the command has begun at its ';', unsigned, before its signature is seen."""
    async with open_room(tmp_path, {"planner": peer(tmp_path, "planner")}, host="127.0.0.1") as room:
        reader, writer = await asyncio.open_connection(*room.tcp)
        writer.write(room.sign("rob_conn_onxxxxx_#1;") + b";rob_conn_onxxxxx_#2;")
        assert await rest_of(reader) in (b"", b"1_accepted_robot_1;")  # the answer may come too late for the connection
        assert [command.source.startswith("tcp:127.0.0.1:") for command in room.core.commands] == [True]
        assert room.gateway.counters.refused == 1
        writer.close()


async def test_one_peer_has_one_session_over_udp_and_tcp(room: Room) -> None:
    await room.ask("target_rotxxxxxx_0_0_0_1_#1;")
    reader, writer = await asyncio.open_connection(*room.tcp)
    writer.write(b"|;" + room.sign("target_tslxxxxxx_0_0_0_#2;") + b";")
    assert (await reader.readuntil(b";")).startswith(b"2_accepted")
    assert room.core.operations == ["plan"]
    writer.close()
