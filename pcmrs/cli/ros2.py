"""`pcmrs ros2`: publishes the state of a cell for ROS 2."""

from __future__ import annotations

import asyncio
import signal
import sys
from pathlib import Path

import click

import pcmrs.lean_structlog  # noqa: F401
from pcmrs.cli.options import config_options, json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.running import readable_errors, run
from pcmrs.errors import ConfigurationError


@click.command()
@config_options
@json_option
@readable_errors
def ros2(file: Path | None, overrides: tuple[str, ...], as_json: bool) -> None:
    """Publish joints, frames, poses and the state of a running cell for ROS 2, until Ctrl-C.

    --config and --set are those of its daemon: from them come the cell's address, the arm and its calibration. The
    messages are standard ones, as CDR, on the cell's bus; zenoh-bridge-ros2dds, started with the printed command, maps
    them to /joint_states, /tf, /tf_static, /state and /pose/BODY. Of the messages that ROS publishes there, the cell
    only receives the poses of /tracker/NAME, if the tracker's driver is ros2.

    Exit status: 0 ended, 3 no daemon, 4 bad configuration or a package is missing.

    Example: pcmrs ros2 --config lab.toml
    """
    try:
        from pcmrs.ros2.copying import copy_for_ros2
    except ModuleNotFoundError as error:
        text = f"Messages of ROS 2 are written by the package {error.name}, which is missing: "
        text += "install the extra ros2 (docs/supply.md)."
        raise ConfigurationError(text, package=error.name) from None
    from pcmrs.kinematics.urdf_arms import find_arm
    from pcmrs.ros2.topics import namespace
    from pcmrs.settings import read_settings
    from pcmrs.workflows.mounting import Mounting

    settings = read_settings(file, overrides)
    cell = settings.cell
    bridge = {"endpoint": cell.endpoint, "namespace": namespace(cell.site, cell.name)}
    arm, mounting = find_arm(settings.robot.model), Mounting.read(settings.procedure.calibration)

    async def copy() -> dict[str, int]:
        loop, ended = asyncio.get_running_loop(), asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, ended.set)
        return await copy_for_ros2(settings.bus("client"), arm, mounting, cell.rate, ended)

    _say(bridge, "zenoh-bridge-ros2dds -m client -e {endpoint} -n {namespace}".format(**bridge), as_json)
    counts = run(copy())
    _say(counts, "published: " + ", ".join(f"/{name} {count}" for name, count in counts.items()), as_json)


def _say(data: dict[str, str] | dict[str, int], line: str, as_json: bool) -> None:
    if as_json:
        say_json(data)
    else:
        say(line)
    sys.stdout.flush()
