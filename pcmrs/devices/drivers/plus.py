"""Driver of a tracker behind a PLUS server, over OpenIGTLink.

Written from the source of PlusLib (vtkPlusOpenIGTLinkServer, vtkPlusIgtlMessageFactory; OpenIGTLink header versions 1
and 2). Not tested on hardware, nor with a PLUS server. The server sends TRANSFORM, TDATA or both; names are
``XToTracker``, lengths are in mm. Needs the extra ``hardware`` (`pyigtl`).
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Collection, Mapping
from contextlib import asynccontextmanager, closing
from typing import Annotated, Any

import msgspec

from pcmrs.background import background_task
from pcmrs.clock import Clock
from pcmrs.devices.tables import check_devices, check_names, read_table
from pcmrs.errors import ConfigurationError

NAMES = {"coil": "CoilToTracker", "body_ref": "ReferenceToTracker", "pointer": "StylusToTracker"}


class PlusSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table ``plus`` of the configuration.

    Attributes:
        host: Host name or address of the server.
        port: TCP port of the server.
        names: Name of the transform from each body to the tracker frame; a TDATA name has 20 letters at most.
        latency: Time from exposure to arrival, s; used if the server's clock does not agree with ours.

    Raises:
        ConfigurationError: There are no names, or two bodies share one.
    """

    host: str = "127.0.0.1"
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)] = 18944
    names: dict[str, str] = msgspec.field(default_factory=lambda: dict(NAMES))
    latency: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.02

    def __post_init__(self) -> None:
        check_names("plus.names", self.names, "transform")


@asynccontextmanager
async def open_devices(
    devices: Collection[str], settings: Mapping[str, Any], clock: Clock
) -> AsyncIterator[Mapping[str, Any]]:
    """Open the tracker; see `pcmrs.devices.protocols.OpenDriver`. An absent server is tried again and again.

    Args:
        devices: Only ``tracker``.
        settings: Whole configuration as plain data; ``plus`` is read.
        clock: Clock of the machine.

    Raises:
        ConfigurationError: Another device is requested, the table ``plus`` is wrong, or `pyigtl` is missing.
    """
    check_devices("plus", devices, "tracker")
    own = read_table(settings, "plus", PlusSettings)
    try:
        from pcmrs.devices.plus.tracker import PlusTracker
    except ModuleNotFoundError as error:
        text = f"The driver plus needs {error.name}, which is not installed; install the extra: pcmrs[hardware]."
        raise ConfigurationError(text, module=error.name) from None
    tracker = PlusTracker(own.host, own.port, own.names, own.latency, clock)
    async with background_task(tracker.run(), "PLUS client"):
        with closing(tracker):
            yield {"tracker": tracker}
