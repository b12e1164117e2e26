"""The KST protocol byte by byte, and whatever a network or a stranger makes of it."""

import asyncio
import socket
import threading
import time
from collections.abc import Awaitable, Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.clock import SystemClock
from pcmrs.devices.kst.connection import ImpedanceSettings, KstConnection
from pcmrs.devices.kst.link import KstLink
from pcmrs.devices.kst.wire import LONGEST, LineBuffer, parse_values, words
from pcmrs.errors import DeviceError, DeviceRefusedError, MotionInterruptedError, PayloadError, UnknownOutcomeError
from tests.unit.devices.kst_peer import Peer, served

Q = [0.1, -0.2, 0.3, -1.5, 1e-7, 1.23456789, -3.0]
Q_WIRE = b"0.10000_-0.20000_0.30000_-1.50000_0.00000_1.23457_-3.00000_"
DONE = b"done\n"
SEVEN = b"0.1_-0.2_1.0E-4_-1.5_0.0_2.5E7_-3.0_\n"
SEVEN_VALUES = [0.1, -0.2, 1e-4, -1.5, 0.0, 2.5e7, -3.0]

Step = Callable[[KstConnection], Awaitable[Any]]


async def reply_of(future: "asyncio.Future[str]") -> str:
    return await future


TRANSCRIPTS: dict[str, tuple[Step, list[tuple[bytes, bytes]], Any]] = {
    "tool frame": (
        lambda c: c.set_tool_frame([0.01, 0.0, 0.125], [0.5, 0.0, -0.5]),
        [(b"TFtrans_10.00000_0.00000_125.00000_0.50000_0.00000_-0.50000\n", DONE)],
        None,
    ),
    "joint motion": (
        lambda c: c.ptp_joints(Q, 0.02),
        [(b"jRelVel_0.02_\n", DONE), (b"jp_" + Q_WIRE + b"\n", DONE), (b"doPTPinJS\n", DONE + DONE)],
        None,
    ),
    "Cartesian motion": (
        lambda c: c.ptp_cartesian([0.5, -0.1, 0.4], [3.0, 0.0, -3.0], 0.1),
        [
            (b"jRelVel_0.1_\n", DONE),
            (b"cArtixanPosition_500.00000_-100.00000_400.00000_3.00000_0.00000_-3.00000_\n", DONE),
            (b"doPTPinCS\n", DONE + DONE),
        ],
        None,
    ),
    "joints": (lambda c: c.joints(), [(b"getJointsPositions\n", SEVEN)], SEVEN_VALUES),
    "pose": (
        lambda c: c.pose(),
        [(b"Eef_pos\n", b"500.0_-100.5_0.001_3.0_1.0E-5_-3.0_\n")],
        [0.5, -0.1005, 1e-6, 3.0, 1e-5, -3.0],
    ),
    "force": (lambda c: c.force(), [(b"Eef_force\n", b"1.5_-2.0E-4_3.0_\n")], [1.5, -2e-4, 3.0]),
    "moment": (lambda c: c.moment(), [(b"Eef_moment\n", b"0.1_0.2_0.3_\n")], [0.1, 0.2, 0.3]),
    "external torques": (lambda c: c.external_torques(), [(b"Torques_ext_J\n", SEVEN)], SEVEN_VALUES),
    "measured torques": (lambda c: c.measured_torques(), [(b"Torques_m_J\n", SEVEN)], SEVEN_VALUES),
    "servo starts": (lambda c: c.start_servo(), [(b"startDirectServoJoints\n", DONE)], None),
    "servo stops": (lambda c: c.stop_servo(), [(b"stopDirectServoJoints\n", DONE)], None),
    "impedance starts": (
        lambda c: c.start_impedance(ImpedanceSettings(tool_mass=0.8, translation_stiffness=2000.0), Q),
        [
            (b"jp_" + Q_WIRE + b"\n", DONE),
            (
                b"startSmartImpedneceJoints_0.80000_0.00000_0.00000_80.00000_2000.00000_300.00000_100.00000_\n",
                DONE,
            ),
        ],
        None,
    ),
    "impedance stops": (lambda c: c.stop_impedance(), [(b"stopDirectServoJoints\n", DONE + DONE)], None),
    "impedance stops, acknowledged once": (
        lambda c: c.stop_impedance(),
        [(b"stopDirectServoJoints\n", DONE)],
        None,
    ),
    "joints of the stream": (
        lambda c: reply_of(c.stream_for_joints(Q)),
        [(b"jpJP_" + Q_WIRE + b"\n", SEVEN)],
        SEVEN[:-1].decode(),
    ),
    "torques of the stream": (
        lambda c: reply_of(c.stream_for_torques(Q)),
        [(b"jpExT_" + Q_WIRE + b"\n", SEVEN)],
        SEVEN[:-1].decode(),
    ),
}


async def conversation(
    step: Step, script: list[tuple[bytes, bytes]], chunk: int | None = None, timeout: float = 0.5
) -> tuple[Any, bytes]:
    """What the client makes of answers that come `chunk` bytes at a time, and all that it sent."""
    heard = bytearray()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        for request, answer in script:
            heard.extend(await reader.readexactly(len(request)))
            for start in range(0, len(answer), chunk or len(answer)):
                writer.write(answer[start : start + (chunk or len(answer))])
                await writer.drain()
                await asyncio.sleep(0)
        heard.extend(await reader.read())
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    host, port = server.sockets[0].getsockname()[:2]
    cabinet = await KstConnection.open(host, port, SystemClock(), 1.0, timeout)
    try:
        result = await step(cabinet)
    finally:
        cabinet.end()
        await asyncio.sleep(0.02)  # the server reads the end
        server.close()
    return result, bytes(heard)


@pytest.mark.parametrize("chunk", [None, 1])
@pytest.mark.parametrize("what", list(TRANSCRIPTS))
async def test_every_request_and_reply_of_the_protocol(what: str, chunk: int | None) -> None:
    step, script, expected = TRANSCRIPTS[what]
    result, heard = await conversation(step, script, chunk)
    assert heard == b"".join(request for request, _ in script) + b"end\n"
    if isinstance(expected, list):
        assert np.allclose(result, expected, rtol=1e-12, atol=0.0)
    else:
        assert result == expected


async def test_a_set_point_has_no_reply() -> None:
    async def step(cabinet: KstConnection) -> None:
        cabinet.stream(Q)
        cabinet.stream(Q)

    _, heard = await conversation(step, [])
    assert heard == 2 * (b"jf_" + Q_WIRE + b"\n") + b"end\n"


@pytest.mark.parametrize(
    ("answer", "error"), [(b"nak\n", DeviceRefusedError), (b"interrupted\n", MotionInterruptedError)]
)
@pytest.mark.parametrize("accepted", [b"", DONE])
async def test_a_refused_or_interrupted_motion_is_a_typed_failure(
    answer: bytes, error: type[DeviceError], accepted: bytes
) -> None:
    _, script, _ = TRANSCRIPTS["joint motion"]

    async def step(cabinet: KstConnection) -> Any:
        with pytest.raises(error):
            await cabinet.ptp_joints(Q, 0.02)
        return await cabinet.joints()

    result, _ = await conversation(
        step, [*script[:2], (b"doPTPinJS\n", accepted + answer), (b"getJointsPositions\n", SEVEN)]
    )
    assert result.tolist() == SEVEN_VALUES, "the link goes on"


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


async def test_missing_application_is_reported_with_the_remedy() -> None:
    server = await asyncio.start_server(lambda *_: None, "127.0.0.1", 0)
    host, port = server.sockets[0].getsockname()[:2]
    server.close()
    await server.wait_closed()
    with pytest.raises(DeviceError, match="start the KST application"):
        await KstConnection.open(host, port, SystemClock(), 1.0, 0.5)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda c: c.ptp_joints(Q[:6], 0.1), "7 joints"),
        (lambda c: c.ptp_joints([*Q[:6], float("nan")], 0.1), "not finite"),
        (lambda c: c.ptp_joints(Q, 1.5), "relative joint speed"),
        (lambda c: c.ptp_cartesian([0.0, 0.0, float("inf")], [0.0, 0.0, 0.0], 0.1), "not finite"),
    ],
)
async def test_malformed_command_is_never_sent(call: Step, text: str) -> None:
    async def step(cabinet: KstConnection) -> None:
        with pytest.raises(DeviceError, match=text):
            await call(cabinet)

    _, heard = await conversation(step, [])
    assert heard == b"end\n"


JAVA = {"1.0E-4": 1e-4, "-0.0": 0.0, "1.2345678901234567E10": 1.2345678901234567e10, "3.14159": 3.14159}


@pytest.mark.parametrize("text", list(JAVA))
def test_numbers_as_java_writes_them(text: str) -> None:
    assert parse_values(f"{text}_0.0_", 2).tolist() == [JAVA[text], 0.0]


NO_NUMBERS = [
    "NaN",
    "Infinity",
    "-Infinity",
    "nan",
    "inf",
    "1e-4",
    "1.0e-4",
    "1",
    ".5",
    "1.",
    "+1.0",
    "1.0E999",
    "1.0E",
]


@pytest.mark.parametrize("text", [*NO_NUMBERS, "1.0\r", "0x1.0p3", "1,0", " 1.0", ""])
def test_other_numbers_are_refused(text: str) -> None:
    with pytest.raises(PayloadError):
        parse_values(f"{text}_0.0_", 2)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_wrong_count_is_refused(count: int) -> None:
    with pytest.raises(PayloadError, match="not 2 numbers"):
        parse_values("1.0_" * count, 2)


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=7))
def test_written_values_are_within_half_of_the_last_decimal(values: list[float]) -> None:
    assert np.allclose(parse_values(words(values), len(values)), values, rtol=0.0, atol=5.001e-6)


MESSAGES = st.lists(st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), max_size=60), max_size=12)


@given(MESSAGES, st.lists(st.integers(0, 800), max_size=30))
def test_any_splitting_and_merging_gives_the_same_messages(messages: list[str], cuts: list[int]) -> None:
    data = "".join(f"{message}\n" for message in messages).encode()
    places = sorted({0, len(data), *(min(cut, len(data)) for cut in cuts)})
    buffer = LineBuffer()
    heard = [line for begin, end in pairwise(places) for line in buffer.feed(data[begin:end])]
    assert heard == messages


@given(st.binary(max_size=200), st.integers(1, 50))
def test_garbage_is_split_into_text_or_refused(data: bytes, chunk: int) -> None:
    buffer = LineBuffer()
    try:
        for start in range(0, len(data), chunk):
            for line in buffer.feed(data[start : start + chunk]):
                assert line.isprintable()
    except PayloadError:
        return
    assert all(0x20 <= byte < 0x7F or byte == 0x0A for byte in data)


def test_a_line_without_end_is_refused_soon() -> None:
    buffer = LineBuffer()
    buffer.feed(b"0" * LONGEST)
    with pytest.raises(PayloadError, match="without an end"):
        buffer.feed(b"0")


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


@pytest.mark.parametrize("answer", [b"done\n", b"1.0_2.0_\n", b"NaN_" * 7 + b"\n", b"\xff\xfe\n", b"0.0_" * 200])
async def test_invalid_answer_loses_the_link(answer: bytes) -> None:
    async def step(cabinet: KstConnection) -> None:
        with pytest.raises(UnknownOutcomeError, match="link to the cabinet"):
            await cabinet.joints()
        with pytest.raises(UnknownOutcomeError):
            cabinet.stream(Q)

    _, heard = await conversation(step, [(b"getJointsPositions\n", answer)])
    assert heard == b"getJointsPositions\n", "nothing follows"


@pytest.mark.parametrize("answer", [b"Done\n", b"ok\n", SEVEN])
@pytest.mark.parametrize("what", ["servo starts", "servo stops", "impedance stops", "joint motion"])
async def test_answer_other_than_done_is_no_acknowledgement(what: str, answer: bytes) -> None:
    ask, script, _ = TRANSCRIPTS[what]
    request = script[0][0]

    async def step(cabinet: KstConnection) -> None:
        with pytest.raises(UnknownOutcomeError, match=r"The cabinet answered '.+', not 'done'"):
            await ask(cabinet)
        with pytest.raises(UnknownOutcomeError):
            cabinet.stream(Q)

    _, heard = await conversation(step, [(request, answer)])
    assert heard == request, "nothing follows"


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
