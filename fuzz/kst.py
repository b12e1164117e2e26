"""KST: replies of a cabinet to our driver, and requests to the virtual cabinet.

python -m fuzz.kst -max_total_time=60
"""

from __future__ import annotations

import asyncio
import math

from fuzz.running import instrumented, pieces, run

with instrumented("pcmrs.devices.kst", "pcmrs_sim.kst"):
    from pcmrs.clock import SystemClock
    from pcmrs.devices.kst.link import KstLink
    from pcmrs.devices.kst.wire import LONGEST, LineBuffer, parse_values
    from pcmrs.devices.motion.force import ForceSettings
    from pcmrs.errors import PayloadError, PcmrsError
    from pcmrs.kinematics.arms import ARMS
    from pcmrs_sim.cell import CellSimulation
    from pcmrs_sim.kst.cabinet import SimulatedCabinet
    from pcmrs_sim.settings import SimSettings

CLOCK = SystemClock()
CELL = CellSimulation(SimSettings(), ARMS["iiwa14"], ForceSettings(force_limit=math.inf), CLOCK)


def read_lines(data: bytes) -> None:
    """Split and parse replies."""
    buffer = LineBuffer()
    try:
        lines = [line for piece in pieces(data) for line in buffer.feed(piece)]
    except PayloadError:
        return
    for line in lines:
        assert len(line) <= LONGEST
        for count in (3, 6, 7):
            try:
                values = parse_values(line, count)
            except PayloadError:
                continue
            assert values.shape == (count,)
            assert all(map(math.isfinite, values))


def receive_replies(data: bytes) -> None:
    """Check that two awaited replies arrive, or an error after which none follows."""
    link = KstLink("fuzz", CLOCK)
    replies = link.send("getJointsPositions", 60.0, 60.0)
    for piece in pieces(data):
        link.data_received(piece)
    link.connection_lost(None)
    for reply in replies:
        error = reply.exception()
        assert error is None or isinstance(error, PcmrsError)
        if error is not None:
            break


def send_to_cabinet(data: bytes) -> None:
    """Send requests to the virtual cabinet."""
    answers: list[str] = []
    cabinet = SimulatedCabinet(CELL, answers.append, lambda: None)
    for line in data.decode("latin-1").split("\n"):
        cabinet.receive(line.rstrip("\r"))
        cabinet.update()
    cabinet.leave()
    assert all(answer.isascii() for answer in answers)


async def one(data: bytes) -> None:
    """Select a target by the first byte."""
    await asyncio.sleep(0)  # lets callbacks of the last input run
    kind, rest = data[:1], data[1:]
    if kind < b"\x55":
        read_lines(rest)
    elif kind < b"\xaa":
        receive_replies(rest)
    else:
        send_to_cabinet(rest)


if __name__ == "__main__":
    run(one)
