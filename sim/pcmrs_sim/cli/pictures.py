"""`pcmrs-sim render`: pictures and films of the simulated cell, without a display."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from pcmrs.background import background_task
from pcmrs.cli.printing import say
from pcmrs.cli.running import readable_errors
from pcmrs.cli.values import Finite
from pcmrs.errors import ConfigurationError
from pcmrs_sim.cli.options import cell_options

if TYPE_CHECKING:
    # For annotations only: `--help` must not load the simulation.
    from pcmrs_sim.cell_state import CellState
    from pcmrs_sim.cli.png import Picture

FPS = 25
"""Pictures per second of a film."""
LONGEST_FILM = 120.0
"""Longest film, s: each picture is compressed alone."""


@click.command()
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, writable=True, path_type=Path),
    required=True,
    metavar="FILE.png",
    help="Picture or film to write.",
)
@click.option(
    "--duration",
    type=Finite(min=1.0 / FPS, max=LONGEST_FILM),
    metavar="S",
    help="Length of a film in cell time, s; without it, one picture of the start is made.",
)
@click.option(
    "--camera", type=click.Choice(["overview", "tracker"]), default="overview", show_default=True, help="Point of view."
)
@click.option("--volume", is_flag=True, help="Show the measuring volume of the tracker.")
@click.option("--width", type=click.IntRange(64, 1920), default=960, show_default=True, help="Width, pixels.")
@click.option("--height", type=click.IntRange(64, 1080), default=540, show_default=True, help="Height, pixels.")
@readable_errors
@cell_options
def render(
    output: Path,
    duration: float | None,
    camera: str,
    volume: bool,
    width: int,
    height: int,
    settings: dict[str, Any],
    schedule: Path | None,
) -> None:
    """Write a picture or a film of the simulated cell as a PNG file.

    A film is an animated PNG, which browsers play; `ffmpeg -i cell.png cell.mp4` converts it. It is made in simulated
    time, so that it is the same in each run. A schedule moves the person with the pointer ('1.0 touch 0'), and injects
    faults. MuJoCo renders with EGL, or with OSMesa if the environment has MUJOCO_GL=osmesa.

    Example: pcmrs-sim render -o cell.png --duration 10 --schedule touches.txt
    """
    if not output.parent.is_dir():
        raise ConfigurationError(f"There is no folder {output.parent}; create it first.", folder=str(output.parent))
    if output.suffix.lower() != ".png":
        text = f"{output.name} has the wrong ending; write a .png, and convert it: ffmpeg -i cell.png cell.mp4."
        raise ConfigurationError(text, file=str(output))
    # MuJoCo reads it when it is imported. Its default on Linux needs a display.
    os.environ.setdefault("MUJOCO_GL", "egl")
    from pcmrs.simulated_time.loop import SimulatedLoop

    count = 1 if duration is None else max(1, round(duration * FPS))
    with asyncio.Runner(loop_factory=SimulatedLoop) as runner:
        runner.run(_write(output, count, _View(camera, volume, width, height), settings, schedule))
    say(f"wrote {output}: {count} picture{'s' if count > 1 else ''} of {width} x {height} pixels")


class _View(NamedTuple):
    """Camera of the model, whether the measuring volume is shown, and the size of a picture, pixels."""

    camera: str
    volume: bool
    width: int
    height: int


async def _write(output: Path, count: int, view: _View, settings: dict[str, Any], schedule: Path | None) -> None:
    """Run the cell and render it; the file appears when it is complete."""
    from pcmrs.simulated_time.clock import SimulatedClock
    from pcmrs_sim.cell import running_cell
    from pcmrs_sim.cli.lines import follow_schedule, read_schedule
    from pcmrs_sim.cli.png import PngFile

    lines = read_schedule(schedule) if schedule else []
    clock, file, part = SimulatedClock(asyncio.get_running_loop()), PngFile(count, FPS), output.with_suffix(".part")
    async with running_cell(settings, clock) as cell, background_task(follow_schedule(cell, lines), "schedule"):
        renderer = _Renderer(cell.world.observe().model, view)
        try:
            with part.open("wb") as stream:
                for number in range(count):
                    await clock.sleep(number / FPS - clock.monotonic())
                    cell.catch_up()
                    stream.write(file.add(renderer.picture(cell.world.observe())))
            part.replace(output)
        finally:
            part.unlink(missing_ok=True)
            renderer.close()


class _Renderer:
    """Renders the cell without a display.

    Args:
        model: The cell, an ``mujoco.MjModel``.
        view: What is shown.

    Raises:
        ConfigurationError: This machine cannot render.
    """

    def __init__(self, model: Any, view: _View) -> None:
        import mujoco

        from pcmrs_sim.cell_model import VOLUME

        self._view, self._options = view, mujoco.MjvOption()
        self._options.geomgroup[VOLUME] = view.volume
        try:
            self._renderer = mujoco.Renderer(model, height=view.height, width=view.width)
        except (AttributeError, ImportError, RuntimeError, mujoco.FatalError) as error:
            raise ConfigurationError(
                f"MuJoCo cannot render here with MUJOCO_GL={os.environ['MUJOCO_GL']}: {error}. Install libegl1 "
                "with the drivers of Mesa, or install libosmesa6 and set MUJOCO_GL=osmesa."
            ) from None

    def picture(self, cell: CellState) -> Picture:
        """Return a picture of the cell as it is now."""
        cell.refresh()
        self._renderer.update_scene(cell.data, camera=self._view.camera, scene_option=self._options)
        rendered: Picture = self._renderer.render()
        return rendered

    def close(self) -> None:
        """Release the graphics context."""
        self._renderer.close()
