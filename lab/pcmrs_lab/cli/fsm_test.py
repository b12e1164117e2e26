"""`pcmrs fsm test`: a tour through every response of a workflow."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec
from rich.box import SIMPLE_HEAD
from rich.table import Table

from pcmrs.cli.fsm.files import file_argument, output_option, refuse, sound, write
from pcmrs.cli.options import CellAddress, address_options, json_option, refuse_given
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import readable_errors, run
from pcmrs.cli.tables import Terminal
from pcmrs.cli.values import POSITIVE
from pcmrs.errors import PcmrsError

if TYPE_CHECKING:
    from pcmrs.authoring.trial.tour import TourCommand
    from pcmrs.fsm.blueprint import Blueprint
    from pcmrs_lab.experiment.tours.arguments import TourArguments
    from pcmrs_lab.experiment.tours.live import ShowProgress
    from pcmrs_lab.experiment.tours.report import TourReport

MOST_SHOWN = 20
"""Number of deviations that are printed; --json has all."""

LIVE_ONLY = ("connect", "endpoint", "site", "cell", "rate", "seed", "overrides", "arguments_file", "time_limit")
"""Parameters that only apply to a running cell."""


@click.command()
@file_argument
@click.option("--live", is_flag=True, help="Test a running daemon on simulated devices, by default a separate one.")
@click.option("--connect", is_flag=True, help="With --live: test the daemon at --endpoint, which nobody else may use.")
@address_options
@click.option(
    "--rate", type=POSITIVE, default=10.0, show_default=True, help="Speed of the separate daemon's simulation."
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of its simulated errors.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Set one value of its configuration.")
@click.option(
    "--arguments",
    "arguments_file",
    type=click.Path(path_type=Path),
    help="TOML file of arguments, by payload or operation; by default those of the workflow's example plan.",
)
@click.option(
    "--time-limit", type=POSITIVE, default=900.0, show_default=True, help="Seconds after which a live tour ends."
)
@click.option(
    "--limit",
    default=5000,
    type=click.IntRange(min=1),
    show_default=True,
    help="Joint states beyond which a tour is refused.",
)
@output_option
@json_option
@readable_errors
def test(file: str, live: bool, output: Path | None, as_json: bool, limit: int, **given: Any) -> None:
    """Take the workflow FILE through every operation in every joint state, accepted and rejected.

    The tour covers every declared outcome, refusing check and failing step. A script decides how each step ends in
    engine and dispatcher; with --live a whole simulated cell decides it, and Stop makes steps fail. Exit status 0:
    every response was as required, 1: a response deviated or was not covered.
    """
    if not live:
        refuse_given(LIVE_ONLY, "is for --live only: without it no cell is tested.")
    blueprint = sound(file)
    with progress_bar() as show:
        progress = functools.partial(show, "testing")
        work = _live(file, blueprint, limit, progress, **given) if live else _scripted(blueprint, limit, progress)
        try:
            report, tour = run(work)
        except PcmrsError as error:
            refuse(error.text)
    if output is not None:
        write(b"".join(msgspec.json.encode(move) + b"\n" for move in tour), output)
    if as_json:
        say_json(report)
    else:
        _show(report)
    if not report.passed:
        raise SystemExit(1)


async def _scripted(
    blueprint: Blueprint, limit: int, progress: ShowProgress
) -> tuple[TourReport, Sequence[TourCommand]]:
    import logging

    import structlog

    from pcmrs_lab.experiment.tours.run import tour_scripted

    # Errors of steps are expected, since the script raises them; critical errors of the dispatcher are still logged.
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    return await tour_scripted(blueprint, limit, progress)


async def _live(
    file: str,
    blueprint: Blueprint,
    limit: int,
    progress: ShowProgress,
    *,
    connect: bool,
    address: CellAddress,
    rate: float,
    seed: int,
    overrides: tuple[str, ...],
    arguments_file: Path | None,
    time_limit: float,
) -> tuple[TourReport, Sequence[TourCommand]]:
    from pcmrs_lab.experiment.private import private_bench
    from pcmrs_lab.experiment.setup import at_rate
    from pcmrs_lab.experiment.tours.run import tour_live

    arguments = _arguments(blueprint, arguments_file)
    if connect:
        async with address.connect() as client:
            return await tour_live(blueprint, client, arguments, limit, time_limit, progress)
    settings = [f"workflow={file}", f"sim.seed={seed}", *at_rate(rate), *overrides]
    async with private_bench(settings) as bench:
        return await tour_live(blueprint, bench.client, arguments, limit, time_limit, progress)


def _arguments(blueprint: Blueprint, file: Path | None) -> TourArguments:
    """Return the arguments of the example plan (RATMS' if there is none), overridden by those of the file."""
    from pcmrs.testing.plan import example_plan, read_plan
    from pcmrs_lab.experiment.published import PUBLISHED
    from pcmrs_lab.experiment.tours.arguments import TourArguments, plan_arguments, read_arguments

    plan = example_plan(blueprint.id if blueprint.id in PUBLISHED else "ratms")
    planned = plan_arguments(read_plan(plan))
    return TourArguments(planned | (read_arguments(file) if file is not None else {}))


def _show(report: TourReport) -> None:
    from pcmrs.authoring.trial.coverage import MEANINGS

    say(f"{report.workflow} {report.version}: {report.joint_states} joint states, {report.seconds:.1f} s")
    say(f"{report.restarts} restarts, {report.stops} stops, {report.events} events of devices by themselves")
    table = Table("", "covered", "of", box=SIMPLE_HEAD)
    for key, meaning in MEANINGS.items():
        count = report.coverage[key]
        if count.total:
            table.add_row(meaning, str(count.covered), str(count.total))
    Terminal().print(table)
    for subject, deviations in report.deviations.items():
        result = f"{len(deviations)} deviate" if deviations else "all as required"
        say(f"{subject}: {report.subjects[subject]} commands, {result}")
        for deviation in deviations[:MOST_SHOWN]:
            say(f"    {deviation}")
    for left in report.left:
        say(f"not covered ({left.joint_states}×): {left.command}: {left.reason}")
