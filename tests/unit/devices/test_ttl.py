"""The trigger line on a serial port: a byte or a pulse."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pcmrs.devices._ttl import TriggerLine
from pcmrs.testing.clock import ManualClock, settle
from tests.unit.devices.serial_port import Port


@pytest.mark.parametrize("signal", ["dtr", "rts"])
async def test_a_pulse_is_a_pulse_on_the_line(signal: Any) -> None:
    line, port, clock = TriggerLine("", signal, 1, 9600, 0.01), Port(), ManualClock()
    line._serial = port
    pulse = asyncio.create_task(line.pulse(clock))
    await settle()
    await clock.advance(0.009)
    assert port.seen == [(signal, True)]
    await clock.advance(0.002)
    await pulse
    assert port.seen == [(signal, True), (signal, False)]
