"""`pcmrs record` and `pcmrs repair`: recordings of a cell, and the readable part of a damaged one."""

from __future__ import annotations

import asyncio
import os
import platform
import signal
import sys
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import pcmrs.lean_structlog  # noqa: F401
from pcmrs.cli.lifeline import NICENESS, inherited
from pcmrs.cli.log import log_standard_library
from pcmrs.cli.options import OutputFile, config_options, json_option
from pcmrs.cli.printing import say, say_json, say_lines
from pcmrs.cli.running import EXIT_FAILED, readable_errors, run
from pcmrs.cli.values import POSITIVE, Size

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the robot's kinematics.
    from pcmrs.recording.repair import RepairReport
    from pcmrs.recording.writer import RecordingPlan, RecordingReport, RecordingWriter
    from pcmrs.settings import Settings


@click.command()
@click.argument("recording", type=click.Path(path_type=Path), metavar="FILE.mcap")
@click.option("--max-size", type=Size(), help="Start the next file at about this size, such as 512MB.")
@click.option("--max-duration", type=POSITIVE, help="Start the next file after so many seconds.")
@click.option("--max-total", type=Size(), help="Remove the oldest files of this recording beyond this, such as 4GB.")
@click.option(
    "--keep-free",
    type=Size(),
    default="256MB",
    show_default=True,
    help="Free space on the disk below which the recording ends.",
)
@click.option(
    "--topics",
    multiple=True,
    metavar="KEY",
    help="Key expression to record, such as state/pose/*; may be repeated. By default everything but heartbeats.",
)
@click.option("--session", default="", hidden=True, help="Of the daemon that starts this.")
@click.option("--lifeline", is_flag=True, hidden=True, help="Read the configuration from standard input; end with it.")
@config_options
@json_option
@readable_errors
def record(
    recording: Path,
    max_size: float | None,
    max_duration: float | None,
    max_total: float | None,
    keep_free: float,
    topics: tuple[str, ...],
    session: str,
    lifeline: bool,
    file: Path | None,
    overrides: tuple[str, ...],
    as_json: bool,
) -> None:
    """Record all messages of a running cell on its bus, until Ctrl-C.

    --config and --set are those of its daemon: from them come the cell's address, the arm and its calibration. The
    file holds transforms, joints, log, states, gathered data and the plan as Foxglove and Rerun show them, and
    every message unchanged, for pcmrs play. With --max-size or --max-duration the files are numbered: run.0001.mcap,
    run.0002.mcap, …

    Exit status: 0 ended as requested, 5 the disk is full or a file cannot be written, 3 no daemon, 4 bad configuration.

    Example: pcmrs record run.mcap --max-size 512MB --max-total 4GB
    """
    from pcmrs.recording.series import Limits, all_files, check_new, files_of
    from pcmrs.recording.topics import TOPICS, check_topics
    from pcmrs.recording.writer import RecordingPlan
    from pcmrs.settings import read_settings

    log_standard_library(sys.stderr, "%(levelname)s %(message)s")
    if max_total is not None and max_size is None and max_duration is None:
        raise click.UsageError("--max-total needs --max-size or --max-duration: one file alone is never removed.")
    if lifeline:
        settings, key = (given := inherited()).settings, given.device_key
        limits, chosen = settings.recording.limits(), settings.recording.topics
        pool = partial(all_files, recording.parent)
        os.nice(NICENESS)
    else:
        settings = read_settings(file, overrides)
        key = settings.access.read_device_key() or b""
        limits, chosen = Limits(max_size, max_duration, max_total, keep_free), topics or TOPICS
        pool = partial(files_of, recording)
    check_topics(chosen)
    check_new(recording)
    plan = RecordingPlan(recording, limits, _origin(settings, session), pool)
    report = run(_record(settings, plan, chosen, key, lifeline=lifeline))
    if as_json:
        say_json(report)
    else:
        say_lines(_summary(report))
    if report.error is not None:
        sys.exit(EXIT_FAILED)


@click.command()
@click.argument("damaged", type=click.Path(path_type=Path), metavar="FILE.mcap")
@click.option(
    "-o", "--output", type=OutputFile(), required=True, metavar="FILE.mcap", help="File for the readable part."
)
@json_option
@readable_errors
def repair(damaged: Path, output: Path, as_json: bool) -> None:
    """Save the readable part of a damaged recording, up to its last whole chunk, and report how much is lost.

    The damaged file stays as it is. Any MCAP file can be given.

    Exit status: 0 saved, whole or not; 5 it is not an MCAP file; 4 the output exists already.
    """
    from pcmrs.recording.repair import repair as save

    saved = save(damaged, output)
    if as_json:
        say_json(saved)
    else:
        say(_saved(saved))


def _origin(settings: Settings, session: str) -> dict[str, str]:
    return {
        "site": settings.cell.site,
        "cell": settings.cell.name,
        "workflow": settings.workflow,
        "rate": repr(settings.cell.rate),
        "session": session,
        "pcmrs": version("pcmrs"),
        "python": platform.python_version(),
        "machine": platform.node(),
    }


async def _record(
    settings: Settings, plan: RecordingPlan, topics: tuple[str, ...], device_key: bytes, *, lifeline: bool
) -> RecordingReport:
    from pcmrs.bus.seal import Seal
    from pcmrs.clock import SystemClock
    from pcmrs.kinematics.urdf_arms import find_arm
    from pcmrs.node import when_input_ends
    from pcmrs.recording.subscriber import Subscriber
    from pcmrs.recording.views import RecordingViews
    from pcmrs.recording.writer import RecordingWriter
    from pcmrs.workflows.mounting import Mounting

    loop, ended, clock = asyncio.get_running_loop(), asyncio.Event(), SystemClock()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    if lifeline:
        when_input_ends(ended.set)
    mounting = Mounting.read(settings.procedure.calibration)
    views = RecordingViews(find_arm(settings.robot.model), mounting, settings.cell.rate)
    subscriber = await Subscriber.open(settings.bus("client"), topics, clock, Seal(device_key) if device_key else None)
    try:
        writer = RecordingWriter(plan, views, clock)
        with _status(writer, str(plan.first)) as shown:
            showing = asyncio.create_task(shown())
            try:
                return await writer.run(subscriber, ended)
            finally:
                showing.cancel()
    finally:
        await subscriber.close()


@contextmanager
def _status(writer: RecordingWriter, name: str) -> Iterator[Callable[[], Coroutine[Any, Any, None]]]:
    """Show a line on a terminal with the number of recorded messages; the yielded function updates it."""
    if not sys.stderr.isatty():
        yield _nothing
        return
    from pcmrs.cli.tables import Terminal, styled  # not at the top: the daemon's recorder shows nothing

    with Terminal(stderr=True).status(styled(f"recording {name}")) as status:

        async def show() -> None:
            while True:
                await asyncio.sleep(1.0)
                status.update(styled(f"recording {name}: {writer.messages} messages; Ctrl-C ends it"))

        yield show


async def _nothing() -> None:
    pass


def _summary(report: RecordingReport) -> list[str]:
    lost = f", {report.dropped} dropped" if report.dropped else ""
    removed = f"; {report.removed} older files were removed" if report.removed else ""
    files = ", ".join(report.files)
    line = f"{report.messages} messages in {report.duration:.1f} s{lost}: {files}{removed}"
    return [line] if report.error is None else [line, f"ended early: {report.error}"]


def _saved(saved: RepairReport) -> str:
    if saved.complete:
        return f"the file was whole: {saved.messages} messages copied"
    share = 100.0 * saved.lost_bytes / max(1, saved.kept_bytes + saved.lost_bytes)
    return (
        f"{saved.messages} messages saved from {saved.kept_bytes} bytes; the last {saved.lost_bytes} bytes "
        f"({share:.1f} %) are lost: {saved.damage}"
    )
