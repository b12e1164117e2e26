"""The link to a cabinet: late, missing, unwanted and invalid answers."""

import asyncio
import socket
import threading
import time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.clock import SystemClock
from pcmrs.devices.kst.connection import KstConnection
from pcmrs.devices.kst.link import KstLink
from pcmrs.errors import DeviceError, UnknownOutcomeError
from tests.unit.devices.kst_peer import DONE, Q_WIRE, SEVEN, SEVEN_VALUES, Peer, Q, conversation, served


@pytest.mark.parametrize("answer", [b"nak\n", b"interrupted\n"])
async def test_interruption_of_a_stream_is_not_taken_for_its_reply(answer: bytes) -> None:
    async def step(cabinet: KstConnection) -> Any:
        reply = cabinet.stream_for_joints(Q)
        await asyncio.wait_for(reply, 0.5)
        with pytest.raises(DeviceError):
            cabinet.check()
        cabinet.check()
        return reply.result()

    result, _ = await conversation(step, [(b"jpJP_" + Q_WIRE + b"\n", answer + SEVEN)])
    assert result == SEVEN[:-1].decode()


async def test_nothing_is_sent_after_an_answer_that_never_came() -> None:
    peer = Peer()
    peer.answers["Torques_ext_J"] = None
    async with served(peer) as (host, port):
        cabinet = await KstConnection.open(host, port, SystemClock(), 1.0, 0.05)
        with pytest.raises(UnknownOutcomeError, match="did not answer in time"):
            await cabinet.external_torques()
        for call in (cabinet.joints, cabinet.start_servo):
            with pytest.raises(UnknownOutcomeError, match="connect again"):
                await call()
        with pytest.raises(UnknownOutcomeError):
            cabinet.stream(Q)
        await asyncio.sleep(0.02)
    assert peer.lines == ["Torques_ext_J"]


async def test_a_reply_that_is_overdue_in_a_stream_fails_the_link() -> None:
    peer = Peer()
    peer.answers["jpJP"] = None
    async with served(peer) as (host, port):
        cabinet = await KstConnection.open(host, port, SystemClock(), 1.0, 0.05)
        cabinet.stream_for_joints(Q)
        cabinet.stream(Q)
        with pytest.raises(DeviceError, match="is outstanding"):
            cabinet.stream_for_torques(Q)
        await asyncio.sleep(0.06)
        with pytest.raises(UnknownOutcomeError):
            cabinet.stream(Q)


async def test_a_peer_that_goes_away_fails_what_is_awaited() -> None:
    peer = Peer()
    peer.answers["getJointsPositions"] = None
    async with served(peer) as (host, port):
        cabinet = await KstConnection.open(host, port, SystemClock(), 1.0, 5.0)
        asking = asyncio.create_task(cabinet.joints())
        await asyncio.sleep(0.02)
        peer.close()
        with pytest.raises(UnknownOutcomeError, match="is lost"):
            await asking


class Transport(asyncio.Transport):
    """Of a link without a network."""

    def write(self, data: object) -> None:
        pass

    def abort(self) -> None:
        pass


async def _answered(data: bytes, chunk: int) -> str | Exception:
    """What becomes of a question that is answered with this."""
    link = KstLink("here", SystemClock())
    link.connection_made(Transport())
    (reply,) = link.send("getJointsPositions", 1.0)
    for start in range(0, len(data), chunk):
        link.data_received(data[start : start + chunk])
    link.connection_lost(None)
    error = reply.exception()
    if error is not None:
        assert isinstance(error, Exception)
        return error
    return reply.result()


@given(st.binary(max_size=100) | st.sampled_from([b"nak\n", b"interrupted\n", SEVEN, DONE]), st.integers(1, 20))
def test_whatever_answers_a_question_ends_it(data: bytes, chunk: int) -> None:
    outcome = asyncio.run(_answered(data, chunk))
    if isinstance(outcome, Exception):
        assert isinstance(outcome, DeviceError | UnknownOutcomeError)
    else:
        assert data.startswith(outcome.encode() + b"\n")


async def test_reply_that_arrived_while_this_process_hung_is_taken() -> None:
    """The time for it is over by then, but the cabinet has answered in time."""
    answered = threading.Event()

    def serve(listening: socket.socket) -> None:
        connection, _ = listening.accept()
        with connection:
            assert connection.recv(100) == b"getJointsPositions\n"
            connection.sendall(SEVEN)
            answered.set()
            assert connection.recv(100) == b"Torques_ext_J\n"
            connection.sendall(SEVEN)
            connection.recv(100)

    with socket.create_server(("127.0.0.1", 0)) as listening:
        serving = threading.Thread(target=serve, args=(listening,), daemon=True)
        serving.start()
        host, port = listening.getsockname()
        cabinet = await KstConnection.open(host, port, SystemClock(), 1.0, 0.2)
        asking = asyncio.create_task(cabinet.joints())
        await asyncio.sleep(0)  # it is sent
        assert answered.wait(10.0)
        time.sleep(0.3)  # noqa: ASYNC251 - the loop does something else meanwhile
        assert (await asking).tolist() == SEVEN_VALUES
        assert (await cabinet.external_torques(10.0)).tolist() == SEVEN_VALUES, "the link goes on"
        cabinet.end()
        await asyncio.to_thread(serving.join)


async def test_an_answer_nobody_asked_for_loses_the_link() -> None:
    async def step(cabinet: KstConnection) -> None:
        await cabinet.joints()
        await asyncio.sleep(0.02)
        with pytest.raises(UnknownOutcomeError, match="without a request"):
            cabinet.check()

    await conversation(step, [(b"getJointsPositions\n", SEVEN + DONE)])


POLLED = b"jpJP_" + Q_WIRE + b"\n"


@pytest.mark.parametrize("chunk", [None, 1], ids=["merged", "split"])
@pytest.mark.parametrize("answer", [DONE + SEVEN, SEVEN + DONE], ids=["end_first", "reading_first"])
async def test_a_motion_may_end_before_or_after_a_reading(answer: bytes, chunk: int | None) -> None:
    async def step(cabinet: KstConnection) -> Any:
        ended = await cabinet.start_ptp(0.1)
        reading = await asyncio.wait_for(cabinet.stream_for_joints(Q), 0.5)
        await asyncio.wait_for(ended, 0.5)
        cabinet.check_ended(ended)
        cabinet.check()
        return cabinet.values(reading).tolist()

    result, _ = await conversation(step, [(b"doPTPinJS\n", DONE), (POLLED, answer)], chunk)
    assert result == SEVEN_VALUES


@pytest.mark.parametrize("answer", [b"nak\n", b"interrupted\n"])
async def test_a_motion_that_breaks_off_leaves_the_reading(answer: bytes) -> None:
    async def step(cabinet: KstConnection) -> Any:
        ended = await cabinet.start_ptp(0.1)
        reading = await asyncio.wait_for(cabinet.stream_for_joints(Q), 0.5)
        with pytest.raises(DeviceError):
            cabinet.check_ended(ended)
        cabinet.check()
        return reading

    result, _ = await conversation(step, [(b"doPTPinJS\n", DONE), (POLLED, answer + SEVEN)])
    assert result == SEVEN[:-1].decode()


async def test_a_motion_that_is_refused_at_once_has_no_end() -> None:
    async def step(cabinet: KstConnection) -> Any:
        with pytest.raises(DeviceError, match="refused"):
            await cabinet.start_ptp(0.1)
        return (await cabinet.joints()).tolist()

    result, _ = await conversation(step, [(b"doPTPinJS\n", b"nak\n"), (b"getJointsPositions\n", SEVEN)])
    assert result == SEVEN_VALUES


async def test_a_motion_whose_end_is_overdue_fails_the_link() -> None:
    async def step(cabinet: KstConnection) -> Any:
        ended = await cabinet.start_ptp(0.05)
        await asyncio.sleep(0.2)
        with pytest.raises(UnknownOutcomeError, match="did not answer in time"):
            cabinet.check()
        with pytest.raises(UnknownOutcomeError):
            ended.result()

    await conversation(step, [(b"doPTPinJS\n", DONE)], timeout=0.1)
