"""Readiness of the devices at the start: all have answered, or are known to be absent."""

from __future__ import annotations

import asyncio
from collections.abc import Collection

import structlog

from pcmrs.clock import Clock
from pcmrs.devices.gate import ACTS
from pcmrs.errors import DeviceError
from pcmrs.settings import Settings

log = structlog.get_logger(__name__)

DEVICES_TIME = 120.0
"""Limit from the start to the first message of every device, s of the machine.

On two cores beside eight processes that compute, the node of the simulated cell took more than 30 s to start.
"""

NOTED_AFTER = 10.0
"""Time from the start after which the log names the devices that are still silent, s of the machine."""

NEEDED_BY = {"robot": "robot", "tracker": "registration"}
"""Device to the branch that needs it, also if another machine runs its node."""


def awaited(settings: Settings, branches: Collection[str]) -> set[str]:
    """Return the devices that the daemon starts itself, and robot and tracker if the workflow needs them.

    All must be ready, since the node of one may serve a device that the node of another connects to.

    Args:
        settings: The whole configuration.
        branches: Branches of the workflow.
    """
    here = {device for devices in settings.drivers().values() for device in devices}
    return here | {device for device, branch in NEEDED_BY.items() if branch in branches}


class DeviceReadiness:
    """Awaited devices that have not answered yet.

    The gate of a device that acts must be known, too: it cannot be released before. Its first heartbeat may be lost.

    Args:
        devices: The awaited devices.
        clock: The machine's clock.
    """

    def __init__(self, devices: set[str], clock: Clock) -> None:
        self._clock = clock
        self._silent = set(devices)
        self._unknown_gates = self._silent & ACTS.keys()
        self._ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._end_when_complete()

    @property
    def complete(self) -> bool:
        """True once all have answered."""
        return not self._silent and not self._unknown_gates

    def record_message(self, device: str) -> None:
        """Note a message of a device, or of its node that it is absent: then operations that need it are refused."""
        self._silent.discard(device)
        self._end_when_complete()

    def record_gate(self, device: str) -> None:
        """Note that a heartbeat has reported the device's gate."""
        self._unknown_gates.discard(device)
        self._end_when_complete()

    def fail(self, error: DeviceError) -> None:
        """Fail, since a device will never answer."""
        if not self._ended.done():
            self._ended.set_exception(error)

    async def wait(self) -> None:
        """Wait until all have answered.

        Raises:
            DeviceError: A device has ended, or has not answered within `DEVICES_TIME`.
        """
        try:
            async with self._clock.timeout(DEVICES_TIME):
                try:
                    async with self._clock.timeout(NOTED_AFTER):
                        await asyncio.shield(self._ended)
                except TimeoutError:
                    log.warning("waiting_for_devices", devices=self._awaited(), at_most_s=DEVICES_TIME)
                    await self._ended
        except TimeoutError:
            silent = self._awaited()
            text = f"No answer within {DEVICES_TIME:g} s from: {' and '.join(silent)}; the log says why."
            raise DeviceError(text, devices=silent) from None

    def _awaited(self) -> list[str]:
        return sorted(self._silent | self._unknown_gates)

    def _end_when_complete(self) -> None:
        if self.complete and not self._ended.done():
            self._ended.set_result(None)
