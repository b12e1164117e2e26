"""Every request and reply of the KST protocol, byte by byte, and answers that are none."""

import asyncio
from typing import Any

import numpy as np
import pytest

from pcmrs.clock import SystemClock
from pcmrs.devices.kst.connection import ImpedanceSettings, KstConnection
from pcmrs.errors import DeviceError, DeviceRefusedError, MotionInterruptedError, UnknownOutcomeError
from tests.unit.devices.kst_peer import DONE, Q_WIRE, SEVEN, SEVEN_VALUES, Q, Step, conversation


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
