"""`pcmrs experiment` and `pcmrs demo`: the paper's experiments on the simulated cell."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec
from rich.console import RenderableType

from pcmrs.cli.options import json_option, plot_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import EXIT_REJECTED, readable_errors, run
from pcmrs.cli.tables import print_report, save_svg
from pcmrs.cli.values import Finite
from pcmrs_lab.cli.experiment_options import ExperimentOptions, experiment_options
from pcmrs_lab.cli.workers_options import workers_options
from pcmrs_lab.scale.tasks import HERE, Workers

if TYPE_CHECKING:
    # For annotations only: --help must not load the experiments.
    from pcmrs_lab.experiment.placements import PlacementReport


@click.group()
def experiment() -> None:
    """Repeat the paper's experiments on the simulated cell."""


@experiment.command()
@experiment_options("ratms")
@click.option("--trials", type=click.IntRange(min=2), default=12, show_default=True, help="Number of placements.")
@click.option(
    "--seeds", default=1, show_default=True, type=click.IntRange(min=1), help="Number of seeds, from --seed on."
)
@workers_options(1)
@plot_option
@json_option
@readable_errors
def placements(
    options: ExperimentOptions, trials: int, seeds: int, workers: Workers, plot: Path | None, as_json: bool
) -> None:
    """Place the tool at planned poses, measure it, and compare with the paper's errors.

    Example: pcmrs experiment placements --seeds 10 --report placements.json --plot placements.png

    With --drivers virtual the daemon uses the drivers of real devices, kst and ndi, over TCP. A virtual cabinet and a
    virtual tracker, which share the simulated cell, answer them. This runs in real time.

    With --noise vicra, vega or spectra tracker and arm have the noise, latency and repeatability of data sheets.

    A placement that does not converge is counted, and the next one follows. Each of several seeds runs on its own
    daemon. Exit status 1: another command was refused, such as a registration.
    """
    if workers != HERE and seeds == 1:
        raise click.UsageError(
            "--workers, --cluster and --finished are for many seeds: give their number with --seeds."
        )
    if seeds == 1:
        _plot([_placements(options, trials, as_json=as_json)], plot)
    else:
        _placements_of_seeds(options, trials, seeds, workers, plot, as_json=as_json)


@experiment.command()
@experiment_options(None)
@click.option(
    "--runs",
    type=click.IntRange(min=1),
    help="Instead, judge simulated touches of every row this number of times, without a daemon.",
)
@workers_options(1)
@plot_option
@json_option
@readable_errors
def failures(options: ExperimentOptions, runs: int | None, workers: Workers, plot: Path | None, as_json: bool) -> None:
    """Inject the paper's operator errors; each must be rejected in the state that the paper reports.

    Exit status 1: a run did not end as published. --runs prints the false accept and false reject rates of each gate
    and of a fixed residual limit alone; the exit status is then always 0.

    Example: pcmrs experiment failures --runs 1000 --seed 1 --report rates.json --plot rates.png
    """
    from pcmrs_lab.experiment.published import PUBLISHED

    if options.plan_file is not None and options.workflow is None:
        raise click.UsageError("--plan is the plan of one workflow: name it with --workflow.")
    if plot is not None and runs is None:
        raise click.UsageError("--plot draws the rates of many runs: give their number with --runs.")
    if workers != HERE and runs is None:
        raise click.UsageError("--workers, --cluster and --finished are for many runs: give their number with --runs.")
    workflows = list(PUBLISHED) if options.workflow is None else [options.workflow]
    if runs is None:
        _failures(options, workflows, as_json=as_json)
    else:
        _failure_rates(options, workflows, runs, workers, plot, as_json=as_json)


def _failures(options: ExperimentOptions, workflows: list[str], *, as_json: bool) -> None:
    from pcmrs_lab.cli.tables import failure_table
    from pcmrs_lab.experiment.failures import run_failures

    with progress_bar() as progress:
        report = run(run_failures([options.setup(workflow, progress) for workflow in workflows]))
    _show(report, failure_table(report), options, as_json=as_json)
    if report.summary.as_published < report.summary.runs:
        raise SystemExit(EXIT_REJECTED)


def _failure_rates(
    options: ExperimentOptions,
    workflows: list[str],
    runs: int,
    workers: Workers,
    plot: Path | None,
    *,
    as_json: bool,
) -> None:
    from pcmrs.analysis.plots import save_png
    from pcmrs_lab.cli.experiment_tables import monte_carlo_tables
    from pcmrs_lab.experiment.monte_carlo import run_monte_carlo
    from pcmrs_lab.experiment.plots import monte_carlo_figure

    with progress_bar() as progress:
        report = run_monte_carlo([options.setup(workflow, progress) for workflow in workflows], runs, workers)
    _show(report, monte_carlo_tables(report), options, as_json=as_json)
    if plot is not None:
        save_png(monte_carlo_figure(report), plot)


@experiment.command()
@experiment_options("ratms", rate=1.0)
@click.option(
    "--duration",
    default=20.0,
    show_default=True,
    type=Finite(10.0),
    help="Duration of each motion of the head, s of the cell.",
)
@plot_option
@json_option
@readable_errors
def following(options: ExperimentOptions, duration: float, plot: Path | None, as_json: bool) -> None:
    """Keep the tool at its place on a simulated head that breathes, drifts, shifts and moves quickly.

    Each motion is followed with and without compensation of the tracker's latency; at the end the reference is hidden.
    The column lag shows whether the machine is too slow.

    Example: pcmrs experiment following --seed 1 --report following.json --plot following.png
    """
    from pcmrs.analysis.plots import save_png
    from pcmrs_lab.cli.experiment_tables import following_tables
    from pcmrs_lab.experiment.following import run_following
    from pcmrs_lab.experiment.plots import following_figure

    with progress_bar() as progress:
        report, drawn = run(run_following(options.setup(options.workflow or "ratms", progress), duration))
    _show(report, following_tables(report), options, as_json=as_json)
    if plot is not None:
        save_png(following_figure(drawn), plot)


@experiment.command()
@click.option("--subjects", type=click.IntRange(min=1), default=1000, show_default=True, help="Number of subjects.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the simulated subjects."
)
@click.option(
    "--interval",
    type=Finite(0.02, 0.5),
    default=0.08,
    show_default=True,
    help="Maximum likelihood ends when the 95 % interval is narrower than this share of the threshold.",
)
@workers_options(1)
@plot_option
@json_option
@readable_errors
def thresholds(subjects: int, seed: int, interval: float, workers: Workers, plot: Path | None, as_json: bool) -> None:
    """Estimate the motor thresholds of simulated subjects: pulses and errors of every method, without a daemon.

    Example: pcmrs experiment thresholds --subjects 1000 --seed 1 --plot thresholds.png
    """
    from pcmrs.analysis.plots import save_png
    from pcmrs_lab.cli.threshold_tables import threshold_table
    from pcmrs_lab.experiment.plots import thresholds_figure
    from pcmrs_lab.experiment.thresholds import run_thresholds

    with progress_bar() as progress:
        report, hunted = run_thresholds(subjects, seed, interval, progress, workers)
    print_report(report, threshold_table(report), as_json=as_json)
    if plot is not None:
        save_png(thresholds_figure(report, hunted), plot)


@experiment.command()
@click.option("--subjects", type=click.IntRange(min=1), default=200, show_default=True, help="Number of subjects.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the simulated subjects."
)
@click.option(
    "--intensity",
    type=Finite(50.0, 200.0),
    default=120.0,
    show_default=True,
    help="Intensity of the pulses, percent of the subject's motor threshold.",
)
@plot_option
@json_option
@readable_errors
def hotspots(subjects: int, seed: int, intensity: float, plot: Path | None, as_json: bool) -> None:
    """Search the hot-spots of simulated subjects: pulses to within 5 mm, and errors, without a daemon.

    Example: pcmrs experiment hotspots --subjects 200 --seed 1 --plot hotspots.png
    """
    from pcmrs.analysis.plots import save_png
    from pcmrs_lab.cli.hotspot_tables import hotspot_table
    from pcmrs_lab.experiment.hotspots import run_hotspots
    from pcmrs_lab.experiment.plots import hotspots_figure

    with progress_bar() as progress:
        report, searched, mesh = run_hotspots(subjects, seed, intensity, progress)
    print_report(report, hotspot_table(report), as_json=as_json)
    if plot is not None:
        save_png(hotspots_figure(report, searched, mesh), plot)


@experiment.command()
@click.option("--runs", type=click.IntRange(min=1), default=1000, show_default=True, help="Number of runs of each row.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the touches.")
@plot_option
@json_option
@readable_errors
def registrations(runs: int, seed: int, plot: Path | None, as_json: bool) -> None:
    """Register a head by landmarks and points of its skin: true against predicted error, without a daemon.

    Rows change the number of points, their region, their noise, the hair and the share of outliers. Beside it are the
    refinement that takes hair for skin, and plain ICP of trimesh.

    Example: pcmrs experiment registrations --runs 1000 --seed 1 --plot registrations.png
    """
    from pcmrs.analysis.plots import save_png
    from pcmrs_lab.cli.registration_tables import registration_table
    from pcmrs_lab.experiment.registration_plot import registrations_figure
    from pcmrs_lab.experiment.registrations import run_registrations

    with progress_bar() as progress:
        report = run_registrations(runs, seed, progress)
    print_report(report, registration_table(report), as_json=as_json)
    if plot is not None:
        save_png(registrations_figure(report), plot)


@click.command()
@experiment_options("ratms")
@click.option("--scene", is_flag=True, help="Instead, a hand enters the workspace, which a depth camera watches.")
@json_option
@readable_errors
def demo(options: ExperimentOptions, scene: bool, as_json: bool) -> None:
    """Run a whole procedure on the simulated cell: plan, digitize, register, and 12 placements.

    With --workflow femoroplasty the bone is drilled and injected at the last of them. With --drivers virtual the daemon
    moves the arm and reads the tracker through the drivers of real devices.

    With --scene a hand enters the workspace during an approach: the arm stops, and after the hand has left it goes on.
    This runs in real time, with a simulated depth camera (docs/scene.md).
    """
    if scene:
        _scene(options, as_json=as_json)
        return
    speed = "in real time" if options.rate == 1.0 else f"{options.rate:g} times as fast as real time"
    devices = ", behind a virtual KUKA cabinet and a virtual NDI tracker" if options.drivers == "virtual" else ""
    text = f"A simulated cell, {speed}{devices}; speed limits as configured. Commands go over UDP, as from 3D Slicer."
    say(text, err=as_json)
    say("Research software, not a medical device.", err=as_json)
    _placements(options, 12, as_json=as_json)


def _scene(options: ExperimentOptions, *, as_json: bool) -> None:
    from pcmrs_lab.experiment.scene_demo import run_scene_demo

    tell = partial(say, err=as_json)
    tell("A simulated cell with a simulated depth camera, in real time. Research software, not a medical device.")
    report = run(run_scene_demo(options.seed, options.overrides, tell))
    if as_json:
        say_json(report)
    else:
        say(f"From the first image that shows the hand: sure after {report.sure_after_ms:.0f} ms, ", nl=False)
        say(f"braking after {report.braking_after_ms:.0f} ms, ", nl=False)
        say(f"standstill after {report.standstill_after_ms:.0f} ms, ", nl=False)
        say(f"joints turned by at most {report.travelled_deg:.1f}° until then.")
    if options.report_file is not None:
        options.report_file.write_bytes(msgspec.json.encode(report) + b"\n")


def _placements(options: ExperimentOptions, trials: int, *, as_json: bool) -> PlacementReport:
    from pcmrs_lab.cli.tables import placement_table
    from pcmrs_lab.experiment.placements import run_placements

    with progress_bar() as progress:
        report = run(run_placements(options.setup(options.workflow or "ratms", progress), trials))
    _show(report, placement_table(report), options, as_json=as_json)
    return report


def _placements_of_seeds(
    options: ExperimentOptions, trials: int, seeds: int, workers: Workers, plot: Path | None, *, as_json: bool
) -> None:
    from pcmrs_lab.cli.experiment_tables import seeds_tables
    from pcmrs_lab.experiment.placement_seeds import run_seeds

    with progress_bar() as progress:
        report = run_seeds(options.setup(options.workflow or "ratms", progress), trials, seeds, workers)
    _show(report, seeds_tables(report), options, as_json=as_json)
    _plot(report.reports, plot)
    if len(report.reports) < seeds:
        raise SystemExit(EXIT_REJECTED)


def _plot(reports: list[PlacementReport], plot: Path | None) -> None:
    from pcmrs.analysis.plots import save_png
    from pcmrs_lab.experiment.placement_plot import placements_figure

    if plot is not None and reports:
        save_png(placements_figure(reports), plot)


def _show(report: msgspec.Struct, table: RenderableType, options: ExperimentOptions, *, as_json: bool) -> None:
    print_report(report, table, as_json=as_json)
    if options.table is not None:
        save_svg(table, options.table)
    if options.report_file is not None:
        options.report_file.write_bytes(msgspec.json.encode(report) + b"\n")
