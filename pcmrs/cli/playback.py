"""`pcmrs play`: publishes a recording on the bus again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say_json, say_lines
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import readable_errors, run
from pcmrs.cli.values import POSITIVE, Finite

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the bus.
    from pcmrs.recording.playback import Excerpt, PlaybackReport, Progress


@click.command()
@click.argument("files", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="FILE.mcap...")
@click.option("--rate", type=POSITIVE, default=1.0, show_default=True, help="Speed relative to the recording.")
@click.option("--from", "begin", type=Finite(0.0), default=0.0, help="Begin so many seconds after its first message.")
@click.option("--to", "end", type=Finite(0.0), help="End so many seconds after its first message.")
@click.option("--topics", multiple=True, metavar="KEY", help="Key expression of the messages to play; may be repeated.")
@click.option("--as", "name", help="Play as pcmrs/replay/NAME; by default the name of the recorded cell.")
@click.option(
    "--endpoint",
    default="tcp/127.0.0.1:7447",
    envvar="PCMRS_ENDPOINT",
    show_default=True,
    help="Endpoint of the bus to play on.",
)
@json_option
@readable_errors
def play(
    files: tuple[Path, ...],
    rate: float,
    begin: float,
    end: float | None,
    topics: tuple[str, ...],
    name: str | None,
    endpoint: str,
    as_json: bool,
) -> None:
    """Publish recordings on the bus again, byte for byte, under pcmrs/replay/NAME.

    Give the files of one recording in their order. Of a damaged file, the readable part is played. No cell's own prefix
    can be given, and one at which a daemon runs is refused: a recording commands nothing. Ctrl-C ends it.

    Exit status: 0 played, 5 no recording, 3 nobody at the endpoint, 4 a daemon runs under that name, 130 after Ctrl-C.

    Example: pcmrs play run.0001.mcap run.0002.mcap --rate 4 --topics 'state/**'
    """
    from pcmrs.recording.playback import Excerpt, read_cell_name

    if end is not None and end <= begin:
        raise click.UsageError(f"--to {end:g} must be later than --from {begin:g}.")
    excerpt = Excerpt(begin, end, topics, rate)
    with progress_bar(transient=True) as progress:
        played = run(_play(files, excerpt, endpoint, name or read_cell_name(files[0]), progress))
    if as_json:
        say_json(played)
    else:
        say_lines(_lines(played))


async def _play(
    files: tuple[Path, ...], excerpt: Excerpt, endpoint: str, name: str, progress: Progress
) -> PlaybackReport:
    from pcmrs.clock import SystemClock
    from pcmrs.recording.playback import PlaybackPublisher

    player = await PlaybackPublisher.open(endpoint, name, SystemClock())
    try:
        return await player.play(files, excerpt, progress)
    finally:
        await player.close()


def _lines(played: PlaybackReport) -> list[str]:
    line = f"{played.messages} messages of {played.duration:.1f} s under {played.prefix}"
    lost = [f"{line}; {played.lost_bytes} bytes in all are not readable" for line in played.damage]
    return [line, *lost]
