"""Tracker by way of ROS 2: poses from sensors of ROS, which zenoh-bridge-ros2dds puts on the cell's bus.

It is not in `pcmrs.devices.drivers`, because it is a client of the bus. Not tested on hardware, nor with ROS. It needs
the extra ``ros2`` (`pycdr2`).
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Collection, Mapping
from contextlib import asynccontextmanager, closing
from pathlib import Path
from typing import Annotated, Any

import msgspec
import structlog

from pcmrs.background import background_task
from pcmrs.bus import Bus, BusSettings
from pcmrs.bus.settings import SECURED
from pcmrs.clock import Clock
from pcmrs.devices.tables import check_devices, check_names, read_table
from pcmrs.errors import ConfigurationError

Name = Annotated[str, msgspec.Meta(pattern=r"^[a-z][a-z0-9_]*$")]
NAMES: dict[str, Name] = {"coil": "coil", "body_ref": "body_ref", "pointer": "pointer"}
NOT_SEALED = (
    "Poses on ros2/tracker/* carry no seal: every account on this machine and every device certificate of the cell can "
    "send them. Use this driver only if all of them are trusted."
)

_log = structlog.get_logger(__name__)


class Ros2Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table ``ros2``.

    Attributes:
        names: Body to the last part of its topic, ``/tracker/<name>``.
        frame: The ``frame_id`` of the poses: that of the tracker.
        max_age: Largest time from exposure to arrival, s.
        latency: Time from exposure to arrival to assume while stamps are ahead of this machine's clock, s.

    Raises:
        ConfigurationError: There are no names, or two bodies share one.
    """

    names: dict[str, Name] = msgspec.field(default_factory=lambda: dict(NAMES))
    frame: str = "tracker"
    max_age: Annotated[float, msgspec.Meta(gt=0.0, le=0.5)] = 0.2
    latency: Annotated[float, msgspec.Meta(ge=0.0, le=0.5)] = 0.02

    def __post_init__(self) -> None:
        check_names("ros2.names", self.names, "topic")


@asynccontextmanager
async def open_devices(
    devices: Collection[str], settings: Mapping[str, Any], clock: Clock
) -> AsyncIterator[Mapping[str, Any]]:
    """Open the tracker; see `pcmrs.devices.protocols.OpenDriver`. While nothing is published it has no frames.

    Args:
        devices: Kinds of device to open; only the tracker is possible.
        settings: The whole configuration as plain data.
        clock: Clock of the cell.

    Raises:
        BusError: The cell's daemon does not answer.
        ConfigurationError: Another device is asked for, the table ``ros2`` is wrong, or `pycdr2` is missing.
    """
    check_devices("ros2", devices, "tracker")
    own = read_table(settings, "ros2", Ros2Settings)
    try:
        from pcmrs.ros2._tracker import Accepted, Ros2Tracker
    except ModuleNotFoundError as error:
        text = f"The driver ros2 needs {error.name}, which is not installed; install the extra: pcmrs[ros2]."
        raise ConfigurationError(text, module=error.name) from None
    tracker = Ros2Tracker(Accepted(own.names, own.frame, own.max_age, own.latency), clock)
    _log.warning("tracker_not_sealed", text=NOT_SEALED)
    bus = await Bus.open(_bus(settings, clock))
    try:
        async with background_task(tracker.run(), "frames of ROS 2"):
            with closing(tracker):
                tracker.listen(bus)
                yield {"tracker": tracker}
    finally:
        await bus.close()


def _bus(settings: Mapping[str, Any], clock: Clock) -> BusSettings:
    """Return the settings of the bus for a client, from the whole configuration as plain data.

    Raises:
        ConfigurationError: They are not valid.
    """
    cell = settings["cell"]
    joined = BusSettings(endpoint=cell["endpoint"], site=cell["site"], cell=cell["name"])
    if not joined.endpoint.startswith(SECURED):
        return joined
    from pcmrs.pki import read_credentials  # loads a library for certificates

    credentials = read_credentials(Path(settings["access"]["identity"]), clock.wall())
    return msgspec.structs.replace(joined, credentials=credentials)
