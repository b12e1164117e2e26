"""Waiting at the start until all devices have been heard, or are known to be absent."""

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
"""Every device must have sent something within this after the start, s of the machine.

On two cores beside eight processes that compute, the node of the simulated cell took more than 30 s to start.
"""

NOTED_AFTER = 10.0
"""The log names the devices that are still silent after this, s of the machine."""

NEEDED_BY = {"robot": "robot", "tracker": "registration"}
"""Device to the branch that cannot do without it, also where another machine runs its node."""


def awaited(settings: Settings, branches: Collection[str]) -> set[str]:
    """The devices that a daemon starts itself, and robot and tracker where the workflow needs them.

    All of them, for the node of one may serve what that of another connects to.
    """
    here = {device for devices in settings.drivers().values() for device in devices}
    return here | {device for device, branch in NEEDED_BY.items() if branch in branches}


class DeviceReadiness:
    """Knows which of the awaited devices have not been heard yet.

    Of a device that acts, its gate must be known too: it cannot be released before, and its first beat may be lost.

    Args:
        devices: The awaited ones.
        clock: The machine's.
    """

    def __init__(self, devices: set[str], clock: Clock) -> None:
        self._clock = clock
        self._silent = set(devices)
        self._unknown_gates = self._silent & ACTS.keys()
        self._ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._end_when_complete()

    @property
    def complete(self) -> bool:
        """All have been heard."""
        return not self._silent and not self._unknown_gates

    def hear(self, device: str) -> None:
        """The device has said something, or its node that it does not: then operations that need it say so."""
        self._silent.discard(device)
        self._end_when_complete()

    def hear_gate(self, device: str) -> None:
        """A beat has said what the device's gate lets through."""
        self._unknown_gates.discard(device)
        self._end_when_complete()

    def fail(self, error: DeviceError) -> None:
        """Some device will never be heard."""
        if not self._ended.done():
            self._ended.set_exception(error)

    async def wait(self) -> None:
        """Returns once all have been heard.

        Raises:
            DeviceError: One ended, or was not heard within `DEVICES_TIME`.
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
            text = f"Not heard within {DEVICES_TIME:g} s: {' and '.join(silent)}; the log says why."
            raise DeviceError(text, devices=silent) from None

    def _awaited(self) -> list[str]:
        return sorted(self._silent | self._unknown_gates)

    def _end_when_complete(self) -> None:
        if self.complete and not self._ended.done():
            self._ended.set_result(None)
