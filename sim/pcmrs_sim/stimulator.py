"""The simulated stimulator: charges, fires at the world's muscle, warms up, and disarms by itself."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator

from pcmrs.clock import Clock
from pcmrs.devices.arming import Arming, check_intensity
from pcmrs.devices.stream import Stream
from pcmrs.errors import DeviceError
from pcmrs.messages import DeviceEvent, FiredPulse, StimulatorState
from pcmrs_sim.world import World


class SimStimulator:
    """Implementation of `pcmrs.devices.protocols.StimulatorDriver`.

    Args:
        world: World with its coil and the muscle.
        clock: The cell's clock.
    """

    def __init__(self, world: World, clock: Clock) -> None:
        self._world = world
        self._clock = clock
        self._settings = settings = world.settings.stimulator
        self._arming = Arming(settings.armed_time)
        self._events: Stream[DeviceEvent] = Stream()
        self._intensity = 0.0
        self._charge_generation = 0  # changes when a charge starts or is cancelled
        self._ready_at = -math.inf
        self._heat = 0.0  # of the coil above the room, degrees Celsius, at `_heat_time`
        self._heat_time = clock.monotonic()

    async def state(self) -> StimulatorState:
        return self._state()

    async def set_intensity(self, percent: float) -> StimulatorState:
        self._intensity = check_intensity(percent)
        return self._state()

    async def arm(self) -> StimulatorState:
        self._check_coil()
        self._charge_generation = generation = self._charge_generation + 1
        await self._clock.sleep(self._settings.charge_time)
        if generation != self._charge_generation:
            raise DeviceError("The stimulator was disarmed, or armed again, while it charged.")
        self._arming.arm(self._clock.monotonic())
        return self._state()

    async def disarm(self) -> StimulatorState:
        self._charge_generation += 1
        self._arming.disarm()
        return self._state()

    async def fire(self, number: int) -> FiredPulse:
        self._arming.check(number)
        now = self._clock.monotonic()
        if now < self._ready_at:
            raise DeviceError(
                f"Pulse {number} is refused: the stimulator is ready in {self._ready_at - now:.2f} s.", number=number
            )
        self._arming.take(number, now)
        self._ready_at = now + self._settings.recharge_time
        self._heat = self._heat_at(now) + self._settings.heat * (self._intensity / 100.0) ** 2
        self._heat_time = now
        self._world.stimulate(number, self._intensity, now)
        if self._too_hot(now):
            self._events.publish(self._arming.disarmed(f"The coil is at {self._temperature(now):.1f} degrees Celsius"))
        return FiredPulse(number=number, intensity=self._intensity, fired=now)

    def events(self) -> AsyncIterator[DeviceEvent]:
        return self._events.read()

    def update(self, time: float) -> None:
        """Disarm if it has been armed for too long at a time, s of the clock."""
        if self._arming.expired(time):
            self._events.publish(self._arming.expiry())

    @property
    def can_fire(self) -> bool:
        """True while it is armed."""
        return self._arming.armed

    def lose_node(self, reason: str) -> None:
        """Disarm, and publish an event, because the node is lost.

        Args:
            reason: Clause that says why the node is considered lost.
        """
        self._charge_generation += 1
        if self._arming.armed:
            self._events.publish(self._arming.disarmed(reason.capitalize()))

    def close(self) -> None:
        """Disarm and end all readers."""
        self._charge_generation += 1
        self._arming.disarm()
        self._events.close()

    def _state(self) -> StimulatorState:
        now = self._clock.monotonic()
        return StimulatorState(
            armed=self._arming.armed,
            ready=self._arming.armed and now >= self._ready_at,
            intensity=self._intensity,
            coil_temperature=self._temperature(now),
            pulse=self._arming.pulse,
        )

    def _check_coil(self) -> None:
        now = self._clock.monotonic()
        if self._too_hot(now):
            raise DeviceError(
                f"The coil is at {self._temperature(now):.1f} degrees Celsius, at most {self._settings.hottest:g} is "
                "allowed; let it cool.",
                coil_temperature=self._temperature(now),
                limit=self._settings.hottest,
            )

    def _too_hot(self, now: float) -> bool:
        return self._temperature(now) >= self._settings.hottest

    def _temperature(self, now: float) -> float:
        """Return the temperature of the coil, degrees Celsius."""
        return self._settings.ambient + self._heat_at(now)

    def _heat_at(self, now: float) -> float:
        """Return the temperature above the room, degrees Celsius. It decays exponentially (Newton's law of cooling)."""
        return self._heat * math.exp(-(now - self._heat_time) / self._settings.cooling_time)
