"""`pcmrs-scene`, also `pcmrs scene`: the detector of the scene, as its own process."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import click

import pcmrs.lean_structlog  # noqa: F401
from pcmrs.cli.options import config_options, json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.running import readable_errors, run

if TYPE_CHECKING:
    from pcmrs.scene_node import DetectorSummary


@click.command()
@config_options
@click.option(
    "--record",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write images to a file (.npz) instead of looking at them.",
)
@click.option(
    "--frames", type=click.IntRange(1, 10_000), default=100, show_default=True, help="Number of images to record."
)
@json_option
@readable_errors
def scene(file: Path | None, overrides: tuple[str, ...], record: Path | None, frames: int, as_json: bool) -> None:
    """Watch the zones of a running cell with a depth camera, and report what enters them.

    --config and --set are those of its daemon: from them come the cell's address, the arm and its calibration, and the
    table scene_camera. The scene must be empty at the start, except for arm and body: the first images are the
    background. What the cell does about an event is in its table scene_events. On Ctrl-C a summary is printed, with
    the latency from image to event.

    Exit status: 0 ended, 5 the camera or its images cannot be used, 3 no daemon, 4 bad configuration.

    Example: pcmrs scene --config lab.toml
    """
    from pcmrs.scene_node import detect, open_real_camera
    from pcmrs.scene_node import record as write_recording
    from pcmrs.settings import read_settings

    settings = read_settings(file, overrides)
    if record is not None:
        count = run(write_recording(open_real_camera(settings), record, frames))
        say_json({"file": str(record), "frames": count}) if as_json else say(f"{record}: {count} images")
        return

    async def watch() -> DetectorSummary:
        loop, ended = asyncio.get_running_loop(), asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, ended.set)
        return await detect(settings, lambda _joints: open_real_camera(settings), ended)

    say_summary(run(watch()), as_json)


def say_summary(summary: DetectorSummary, as_json: bool) -> None:
    """Print the summary of a detector's run.

    Args:
        summary: The summary.
        as_json: Print JSON instead of text.
    """
    import msgspec

    if as_json:
        say_json(msgspec.to_builtins(summary))
        return
    say(f"{summary.frames} images, {summary.intrusions} objects in zones")
    say(f"latency from image to event: median {summary.latency_p50_ms:.0f} ms, p99 {summary.latency_p99_ms:.0f} ms")
