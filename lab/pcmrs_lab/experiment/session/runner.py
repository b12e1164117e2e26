"""Runner of a session: register, place, find an intensity, search the hot-spot, estimate the threshold there."""

from __future__ import annotations

from typing import Any

import msgspec

from pcmrs.errors import CommandRefusedError
from pcmrs_lab.experiment.placements import once_seen
from pcmrs_lab.experiment.private import ExperimentBench
from pcmrs_lab.experiment.session.operator import SessionOperator
from pcmrs_lab.experiment.session.setup import SessionSetup
from pcmrs_lab.experiment.setup import ShowProgress

OPERATOR = "simulated operator"
"""Name, in the journal, of the person who sets the ceiling."""
FIRST_INTENSITY, STEP = 50.0, 8.0
"""First intensity and its increase when an intensity for the search is sought, percent of the maximum output."""
LARGE_RESPONSE = 300e-6
"""Response over the hand area, V: after two of this size in a row, smaller ones beside it can be measured."""
MOST_INVALID = 8
"""Number of pulses without a valid measurement in a row that ends the session, to spare the subject more of them."""


class SessionRunner:
    """One session on a running daemon.

    Args:
        bench: The daemon.
        setup: Setup of the session.
        progress: Callback for the present step, the number of pulses, and their expected total.
    """

    def __init__(self, bench: ExperimentBench, setup: SessionSetup, progress: ShowProgress) -> None:
        self._bench = bench
        self._setup = setup
        self._progress = progress
        self._operator = SessionOperator(bench.client, setup.rate, setup.interval)
        self._pulses = self._invalid = 0

    async def run(self) -> None:
        """Run the whole session, and bring the coil home.

        Raises:
            CommandRefusedError: A step was refused, or nothing was found; the text names it and the reason.
        """
        await self._register()
        await self._place_at_centre()
        await self._find_intensity()
        await self._search()
        await self._estimate_threshold()
        self._report("withdrawing")
        await self._operator.withdraw()
        await self._operator.request("robot.disconnect")

    async def _register(self) -> None:
        planner, landmarks = self._bench.planner, msgspec.to_builtins(self._setup.plan.landmarks)
        self._report("planning and digitizing the landmarks")
        await planner.connect()
        await self._operator.request("registration.plan_landmarks", {"landmarks": list(landmarks)})
        await planner.digitize_all()
        self._report("registering")
        await planner.register()

    async def _place_at_centre(self) -> None:
        planner, centre = self._bench.planner, self._setup.centre()
        self._report("placing the coil over the hand area")
        await once_seen(lambda: planner.plan_pose(centre.position, centre.quat_xyzw))
        await self._operator.place()

    async def _find_intensity(self) -> None:
        """Raise the intensity until two responses in a row are large enough, or the ceiling is reached."""
        request, ceiling = self._operator.request, self._setup.ceiling
        await request("stimulation.set_ceiling", {"percent": ceiling, "operator": OPERATOR})
        percent, large = min(FIRST_INTENSITY, ceiling), 0
        await request("stimulation.set_intensity", {"percent": percent})
        while large < 2:
            result = await self._pulse("stimulation.fire", f"looking for an intensity: {percent:g} %")
            if not result.get("counted"):
                continue
            large = large + 1 if result["mep"]["peak_to_peak"] >= LARGE_RESPONSE else 0
            if large == 0 and percent >= ceiling:
                return
            if large == 0:
                percent = min(percent + STEP, ceiling)
                await request("stimulation.set_intensity", {"percent": percent})

    async def _search(self) -> None:
        operator = self._operator
        await operator.request("hotspot.begin", {"method": self._setup.method})
        while (state := await operator.state("hotspot")) == "searching":
            await operator.request("toolplan.aim_hotspot")
            await self._pulse("hotspot.pulse", "searching the hot-spot")
        if state != "found":
            raise CommandRefusedError("No hot-spot was found: no pulse of the search evoked a response.")

    async def _estimate_threshold(self) -> None:
        operator, result = self._operator, {}
        await operator.request("toolplan.aim_hotspot")
        await operator.place()
        await operator.request("threshold.begin", {"method": self._setup.threshold})
        while (state := await operator.state("threshold")) == "hunting":
            result = await self._pulse("threshold.pulse", "estimating the threshold")
        if state != "found":
            raise CommandRefusedError(f"No threshold was found: {result.get('refusal', 'the reason is unknown')}.")

    async def _pulse(self, name: str, doing: str) -> dict[str, Any]:
        """Give one pulse as soon as it is allowed, and return its result. Raises `CommandRefusedError`."""
        self._pulses += 1
        self._report(f"{doing}, pulse {self._pulses}")
        verdict = await self._operator.fire(name)
        result = verdict.result or {}
        self._invalid = 0 if result.get("counted") else self._invalid + 1
        if self._invalid == MOST_INVALID:
            text = result.get("problem_text", "the reason is unknown.")
            raise CommandRefusedError(f"{MOST_INVALID} pulses in a row do not count. The last one: {text}")
        return result

    def _report(self, doing: str) -> None:
        self._progress(doing, self._pulses, max(self._setup.expected_pulses, self._pulses + 1))
