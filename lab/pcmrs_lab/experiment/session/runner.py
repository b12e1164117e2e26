"""The course of a session: register, place, find an intensity, search the hot-spot, hunt the threshold at it."""

from __future__ import annotations

from typing import Any

import msgspec

from pcmrs.errors import CommandRefusedError
from pcmrs_lab.experiment.placements import once_seen
from pcmrs_lab.experiment.private import Bench
from pcmrs_lab.experiment.session.operator import Operator
from pcmrs_lab.experiment.session.setup import SessionSetup
from pcmrs_lab.experiment.setup import ShowProgress

OPERATOR = "simulated operator"
"""Stands for the person who sets the ceiling, and says so in the journal."""
FIRST_INTENSITY, STEP = 50.0, 8.0
"""Where the intensity of the search is looked for, and how it is raised, percent of the maximum stimulator output."""
ENOUGH = 300e-6
"""Two responses in a row of this size over the hand area leave room for smaller ones beside it, V."""
WASTED = 8
"""So many pulses in a row that say nothing about the muscle end the session: nobody should be given more of them."""


class SessionRunner:
    """One session on a running daemon; `run` does it all.

    Args:
        bench: The daemon.
        setup: What is to be done.
        progress: Told what is being done, how many pulses were asked for, and how many there will be, about.
    """

    def __init__(self, bench: Bench, setup: SessionSetup, progress: ShowProgress) -> None:
        self._bench = bench
        self._setup = setup
        self._progress = progress
        self._operator = Operator(bench.client, setup.rate, setup.interval)
        self._pulses = self._wasted = 0

    async def run(self) -> None:
        """Registers, searches, hunts, and brings the coil home.

        Raises:
            CommandRefusedError: A step was refused, or nothing was found; the text says which and why.
        """
        await self._register()
        await self._place_at_centre()
        await self._find_intensity()
        await self._search()
        await self._hunt()
        self._tell("withdrawing")
        await self._operator.withdraw()
        await self._operator.ask("robot.disconnect")

    async def _register(self) -> None:
        planner, landmarks = self._bench.planner, msgspec.to_builtins(self._setup.plan.landmarks)
        self._tell("planning and digitizing the landmarks")
        await planner.connect()
        await self._operator.ask("registration.plan_landmarks", {"landmarks": list(landmarks)})
        await planner.digitize_all()
        self._tell("registering")
        await planner.register()

    async def _place_at_centre(self) -> None:
        planner, centre = self._bench.planner, self._setup.centre()
        self._tell("placing the coil over the hand area")
        await once_seen(lambda: planner.plan_pose(centre.position, centre.quat_xyzw))
        await self._operator.place()

    async def _find_intensity(self) -> None:
        """Raises the intensity until two responses in a row are large enough, or the ceiling is reached."""
        ask, ceiling = self._operator.ask, self._setup.ceiling
        await ask("stimulation.set_ceiling", {"percent": ceiling, "operator": OPERATOR})
        percent, large = min(FIRST_INTENSITY, ceiling), 0
        await ask("stimulation.set_intensity", {"percent": percent})
        while large < 2:
            result = await self._pulse("stimulation.fire", f"looking for an intensity: {percent:g} %")
            if not result.get("counted"):
                continue
            large = large + 1 if result["mep"]["peak_to_peak"] >= ENOUGH else 0
            if large == 0 and percent >= ceiling:
                return
            if large == 0:
                percent = min(percent + STEP, ceiling)
                await ask("stimulation.set_intensity", {"percent": percent})

    async def _search(self) -> None:
        operator = self._operator
        await operator.ask("hotspot.begin", {"method": self._setup.method})
        while (state := await operator.state("hotspot")) == "searching":
            await operator.ask("toolplan.aim_hotspot")
            await self._pulse("hotspot.pulse", "searching the hot-spot")
        if state != "found":
            raise CommandRefusedError("No hot-spot was found: no pulse of the search evoked a response.")

    async def _hunt(self) -> None:
        operator, result = self._operator, {}
        await operator.ask("toolplan.aim_hotspot")
        await operator.place()
        await operator.ask("threshold.begin", {"method": self._setup.threshold})
        while (state := await operator.state("threshold")) == "hunting":
            result = await self._pulse("threshold.pulse", "hunting the threshold")
        if state != "found":
            raise CommandRefusedError(f"No threshold was found: {result.get('refusal', 'nobody knows why')}.")

    async def _pulse(self, name: str, doing: str) -> dict[str, Any]:
        """Give one pulse as soon as it may be given; its result. Raises `CommandRefusedError`."""
        self._pulses += 1
        self._tell(f"{doing}, pulse {self._pulses}")
        verdict = await self._operator.fire(name)
        result = verdict.result or {}
        self._wasted = 0 if result.get("counted") else self._wasted + 1
        if self._wasted == WASTED:
            why = result.get("problem_text", "nobody knows why.")
            raise CommandRefusedError(f"{WASTED} pulses in a row do not count. The last one: {why}")
        return result

    def _tell(self, doing: str) -> None:
        self._progress(doing, self._pulses, max(self._setup.expected_pulses, self._pulses + 1))
