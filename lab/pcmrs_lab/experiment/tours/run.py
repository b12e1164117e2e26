"""Takes a workflow through a test tour: engine and dispatcher on scripted steps, or a running cell."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from dataclasses import dataclass, field

from pcmrs.authoring.trial.coverage import Deviation, coverage, is_complete
from pcmrs.authoring.trial.engine_tour import tour_engine
from pcmrs.authoring.trial.tour import Tour, TourCommand, plan_tour
from pcmrs.client import Client
from pcmrs.errors import ConfigurationError, DeviceError, UnknownOutcomeError
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.testing.rehearsal import rehearse
from pcmrs_lab.experiment.tours.arguments import TourArguments
from pcmrs_lab.experiment.tours.live import LiveTour, ShowProgress
from pcmrs_lab.experiment.tours.observer import observing
from pcmrs_lab.experiment.tours.report import Left, TourReport

SUBJECTS = ("engine", "dispatcher, steps outside", "dispatcher, steps at once")
"""Subjects of a tour without a cell."""


@dataclass
class _TourTally:
    """Results of one subject on a tour."""

    commands: int = 0
    good: set[TourCommand] = field(default_factory=set)
    deviations: list[Deviation] = field(default_factory=list)

    def take(self, move: TourCommand, deviation: Deviation | None) -> None:
        self.commands += 1
        if deviation is None:
            self.good.add(move)
        else:
            self.deviations.append(deviation)


async def tour_scripted(
    blueprint: Blueprint, limit: int, progress: ShowProgress
) -> tuple[TourReport, list[TourCommand]]:
    """Take the engine, and the dispatcher on scripted steps, through a tour.

    Args:
        blueprint: Workflow.
        limit: Largest number of joint states.
        progress: Called after every move.

    Returns:
        Report, and the moves of the tour.

    Raises:
        BlueprintError: The workflow has more than `limit` joint states.
    """
    begin = asyncio.get_running_loop().time()
    tour = plan_tour(blueprint, limit)
    moves = [move for stretch in tour.stretches for move in stretch]
    tallies = {subject: _TourTally() for subject in SUBJECTS}
    done = 0
    async for subject, move, deviation in _toured(blueprint, tour):
        tallies[subject].take(move, deviation)
        done += 1
        progress(done, len(SUBJECTS) * len(moves))
    good = set.intersection(*(tally.good for tally in tallies.values()))
    counts = coverage(blueprint, good, tour.wanted)
    report = TourReport(
        workflow=blueprint.id,
        version=blueprint.version,
        hash=blueprint.hash,
        subjects={subject: tally.commands for subject, tally in tallies.items()},
        joint_states=len({move.before for move in tour.wanted}),
        restarts=len(tour.stretches) - 1,
        seconds=asyncio.get_running_loop().time() - begin,
        coverage=counts,
        deviations={subject: tally.deviations for subject, tally in tallies.items()},
        passed=is_complete(counts) and not any(tally.deviations for tally in tallies.values()),
    )
    return report, moves


async def _toured(blueprint: Blueprint, tour: Tour) -> AsyncIterator[tuple[str, TourCommand, Deviation | None]]:
    engine, outside, at_once = SUBJECTS
    for judged in tour_engine(blueprint, tour):
        yield engine, *judged
    async for judged in rehearse(blueprint, tour, outside=True):
        yield outside, *judged
    async for judged in rehearse(blueprint, tour, outside=False):
        yield at_once, *judged


async def tour_live(
    blueprint: Blueprint, client: Client, arguments: TourArguments, limit: int, seconds: float, progress: ShowProgress
) -> tuple[TourReport, list[TourCommand]]:
    """Take a running cell on simulated devices through a tour.

    Args:
        blueprint: Workflow that the cell runs.
        client: Client of the cell.
        arguments: Arguments of the operations.
        limit: Largest number of joint states.
        seconds: Time after which no further command is sent, s.
        progress: Called after every command.

    Returns:
        Report, and the moves of the tour.

    Raises:
        BlueprintError: The workflow has more than `limit` joint states.
        ConfigurationError: The cell is not simulated, or runs another workflow.
        UnknownOutcomeError: The cell does not answer any more.
    """
    begin = asyncio.get_running_loop().time()
    await _check_simulated(client)
    tag = (await client.state(timeout=10.0)).blueprint
    if tag.hash != blueprint.hash:
        text = f"The cell runs {tag.id} {tag.version} ({tag.hash[:12]}), not {blueprint.id} ({blueprint.hash[:12]})."
        raise ConfigurationError(text, running=tag.hash, given=blueprint.hash)
    async with observing(client) as observer:
        seen = await LiveTour(blueprint, client, observer, arguments, limit).run(seconds, progress)
    counts = coverage(blueprint, seen.made, seen.wanted)
    left = Counter((f"{move.name}:{move.ending}", reason) for move, reason in seen.left.items())
    report = TourReport(
        workflow=blueprint.id,
        version=blueprint.version,
        hash=blueprint.hash,
        subjects={"cell": len(seen.tour)},
        joint_states=len({move.before for move in seen.wanted}),
        stops=seen.stops,
        events=seen.events,
        seconds=asyncio.get_running_loop().time() - begin,
        coverage=counts,
        deviations={"cell": seen.deviations},
        left=[Left(command, count, reason) for (command, reason), count in sorted(left.items())],
        passed=not seen.deviations and counts["pairs"].covered == counts["pairs"].total,
    )
    return report, seen.tour


async def _check_simulated(client: Client) -> None:
    """Refuse a cell that is not simulated: a tour must never move a real arm."""
    try:
        await client.request_device("scene", "truth")
    except (UnknownOutcomeError, DeviceError) as error:
        text = f"A tour performs every motion of the workflow, so it runs on simulated cells only. {error}"
        raise ConfigurationError(text) from error
