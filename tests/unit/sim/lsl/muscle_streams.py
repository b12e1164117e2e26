"""The simulated muscle on streams of real devices, for tests."""

import asyncio
from contextlib import suppress
from typing import Any
from uuid import uuid4

import numpy as np

from pcmrs.clock import SystemClock
from pcmrs.devices.protocols import Emg, Stimulator
from pcmrs.errors import DeviceError
from pcmrs.messages import Epoch

CLOCK = SystemClock()
PATIENCE = 10.0  # s


def configuration(stimulator: str, emg: str) -> dict[str, Any]:
    name = uuid4().hex
    return {
        "stimulator": {"driver": stimulator},
        "emg": {"driver": emg},
        "trigger": {"markers": f"pulses-{name}", "dialled": True},
        "lsl": {"stream": f"emg-{name}", "markers": f"pulses-{name}"},
    }


async def first_answer(stimulator: Stimulator, emg: Emg) -> Epoch:
    """Fires until all streams are connected and the muscle answers; what was sent before is lost, as in a lab."""
    number = 0
    async with asyncio.timeout(PATIENCE):
        while True:
            number += 1
            await stimulator.fire(number)
            with suppress(DeviceError):
                epoch = await emg.epoch(number, 0.05, 0.06)
                if response_of(epoch) > 100e-6:
                    return epoch


def response_of(epoch: Epoch) -> float:
    times = epoch.start + np.arange(len(epoch.samples)) / epoch.rate_hz
    return float(np.ptp(np.array(epoch.samples)[(times > 0.015) & (times < 0.05)]))
