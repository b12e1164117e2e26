"""The detector of the scene with the simulated depth camera, as its own process.

It is `pcmrs scene` with a camera that sees bench, body, a hand, and the arm where its joints say. Lines on standard
input move the hand and harm the camera: ``hand 0.3 0.45 0.3`` (m, in the robot's base), ``hand away``, ``occlude on``,
``freeze on``, ``move 0.5`` (m, back along its axis).

    python -m pcmrs_lab.experiment.scene_detector --set cell.name=cell1
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from pcmrs.cli.options import config_options, json_option
from pcmrs.cli.printing import say
from pcmrs.cli.running import readable_errors, run
from pcmrs.cli.scene import say_summary
from pcmrs.config import as_table
from pcmrs.errors import ConfigurationError
from pcmrs.scene_node import DetectorSummary, detect
from pcmrs.settings import Settings, read_settings
from pcmrs.spatial import Floats
from pcmrs_sim.cli.terminal import forward_lines, termination
from pcmrs_sim.depth_camera import SimulatedDepthCamera, open_simulated

WORDS = ("hand", "occlude", "freeze", "move")


@click.command()
@config_options
@json_option
@readable_errors
def main(file: Path | None, overrides: tuple[str, ...], as_json: bool) -> None:
    """Watch a running simulated cell with a simulated depth camera, and report what enters its zones."""
    settings = read_settings(file, overrides)

    async def watch() -> DetectorSummary:
        def opened(joints: Callable[[], Floats | None]) -> SimulatedDepthCamera:
            camera = camera_of(settings, joints)
            forward_lines(lambda line: _try_line(camera, line))
            return camera

        return await detect(settings, opened, termination())

    say_summary(run(watch()), as_json)


def camera_of(settings: Settings, joints: Callable[[], Floats | None]) -> SimulatedDepthCamera:
    """Return the simulated camera of a cell.

    Args:
        settings: The whole configuration.
        joints: Returns the newest joints of the arm, rad; None if they are not known.
    """
    own = settings.scene_camera
    return open_simulated(as_table(settings), joints, own.pose.transform(), own.rate_hz)


def apply_line(camera: SimulatedDepthCamera, line: str) -> None:
    """Move the hand or harm the camera.

    Args:
        camera: The camera.
        line: Word and arguments.

    Raises:
        ConfigurationError: There is no such word, or its arguments are wrong.
    """
    word, *rest = line.split() or [""]
    if word not in WORDS:
        raise ConfigurationError(f"{word!r} is none of {', '.join(WORDS)}.", line=line)
    try:
        if word == "hand":
            camera.hand = None if rest == ["away"] else _position(rest)
        elif word == "occlude":
            camera.occluded = _is_on(rest)
        elif word == "freeze":
            camera.frozen = _is_on(rest)
        else:
            (camera.moved,) = map(float, rest)
    except ValueError as error:
        raise ConfigurationError(f"{line!r} cannot be done: {error}.", line=line) from None


def _position(words: list[str]) -> tuple[float, float, float]:
    x, y, z = map(float, words)
    return x, y, z


def _is_on(words: list[str]) -> bool:
    if words not in (["on"], ["off"]):
        raise ValueError("write on or off")
    return words == ["on"]


def _try_line(camera: SimulatedDepthCamera, line: str) -> None:
    try:
        apply_line(camera, line)
    except ConfigurationError as error:
        say(error.text, err=True)


if __name__ == "__main__":
    main()
