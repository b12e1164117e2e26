"""Driver of an NDI Polaris or Vega, on a network or serial link, through `ndicapi`.

Written from NDI's commands as `ndicapi` 3.7 sends them (``PHRQ``, ``PVWR``, ``PINIT``, ``PENA``, ``TSTART``, ``BX``, or
``TX`` where the tracker knows no ``BX``) and tested against the virtual tracker of `pcmrs_sim.ndi`, not on hardware.
"""

from __future__ import annotations

import ipaddress
from collections.abc import AsyncGenerator, AsyncIterator, Collection, Mapping, Sequence
from contextlib import aclosing, asynccontextmanager
from typing import Annotated, Any, Literal

import msgspec
import structlog

from pcmrs.clock import Clock
from pcmrs.devices.ndi.poses import FrameReader
from pcmrs.devices.ndi.process import BeepLine, read_reports
from pcmrs.devices.ndi.tools import placeholder, read_tools
from pcmrs.devices.ndi.wire import ReaderJob, TrackerReady
from pcmrs.devices.tables import check_devices, read_table
from pcmrs.errors import ConfigurationError, PcmrsError
from pcmrs.messages import BodyPose

VIRTUAL_BODIES = ("coil", "body_ref", "pointer", "witness")
"""Bodies that the virtual tracker shows if no tools are configured."""

FIRST_PAUSE, LONGEST_PAUSE = 0.5, 10.0
"""Shortest and longest pause between attempts to reach the tracker, s; each one is twice as long as the one before."""

Body = Annotated[str, msgspec.Meta(pattern=r"^[a-z][a-z0-9_]*$")]

log = structlog.get_logger(__name__)


class NdiSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table ``ndi`` of the configuration.

    Attributes:
        device: ``host:port``, or the path of a serial port.
        tools: SROM file of the tool that is fixed to each body; may be left out for a virtual tracker only.
        sha256: Hash of that file by body; any other file is refused.
        latency: Time from the exposure until the frame is available, s.
        max_error_mm: Largest fit error of a valid pose, mm.
        baud: Baud rate of a serial port.

    Raises:
        ConfigurationError: `device` is neither an address with a port nor a path.
    """

    device: str = "127.0.0.1:8765"
    tools: dict[Body, str] = {}
    sha256: dict[Body, str] = {}
    latency: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.030
    max_error_mm: Annotated[float, msgspec.Meta(gt=0.0)] = 1.0
    baud: Literal[9600, 14400, 19200, 38400, 57600, 115200, 921600] = 115200

    def __post_init__(self) -> None:
        host, _, port = self.device.rpartition(":")
        # The library takes a larger port number modulo 65536, and an address without a port as a serial port.
        if not (self.device.startswith("/") or (host and port.isdecimal() and 0 < int(port) < 65536)):
            raise ConfigurationError(
                f"ndi.device is {self.device!r}; it must be host:port with a port of 1 to 65535, such as "
                "192.168.1.50:8765, or the path of a serial port, such as /dev/ttyUSB0.",
                device=self.device,
            )


class NdiTracker:
    """`pcmrs.devices.protocols.TrackerDriver` for NDI trackers. The tracker is read while its frames are iterated over.

    Args:
        settings: Address of the tracker, and limits of its poses.
        tools: Definition of the tool of each body.
        clock: Clock of the machine.

    Attributes:
        trouble: Reason why there are no frames; empty while there are.
    """

    def __init__(self, settings: NdiSettings, tools: Mapping[str, bytes], clock: Clock) -> None:
        self._settings = settings
        self._job = ReaderJob(settings.device, settings.baud, dict(tools))
        self._clock = clock
        self._reader = FrameReader(settings.latency, settings.max_error_mm / 1000.0)
        self._beeps = BeepLine()
        self.trouble = f"The tracker at {settings.device} has not been reached yet."

    def beep(self, count: int) -> None:
        """Sound the tracker's beeper, 1 to 9 times; see `pcmrs.devices.protocols.BeepingTracker`."""
        self._beeps.beep(count)

    async def frames(self) -> AsyncGenerator[Sequence[BodyPose], None]:
        """Yield all bodies of each new frame, for one reader; an absent tracker is tried again without a limit."""
        pause = FIRST_PAUSE
        while True:
            try:
                async with aclosing(self._connection()) as connection:
                    async for poses in connection:
                        pause = FIRST_PAUSE
                        yield poses
            except PcmrsError as error:
                self._report(error, pause)
            await self._clock.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)

    async def _connection(self) -> AsyncGenerator[Sequence[BodyPose], None]:
        async with aclosing(read_reports(self._job, self._clock, self._beeps)) as reports:
            async for report in reports:
                if isinstance(report, TrackerReady):
                    self._ready(report)
                elif poses := self._reader.poses(report, self._clock.monotonic()):
                    yield poses

    def _ready(self, report: TrackerReady) -> None:
        self._reader.restart()
        self.trouble = ""
        version = " ".join(line for line in report.version.splitlines() if line.startswith("Freeze Tag:"))
        command = "BX" if report.binary else "TX"
        log.info("tracker_ready", device=self._settings.device, version=version, command=command)

    def _report(self, error: PcmrsError, pause: float) -> None:
        device = self._settings.device
        self.trouble = f"The tracker at {device}: {error.text}. Check that it is on, and its cable."
        log.warning("tracker_not_there", reason=self.trouble, again_in=pause)


@asynccontextmanager
async def open_devices(
    devices: Collection[str], settings: Mapping[str, Any], clock: Clock
) -> AsyncIterator[Mapping[str, Any]]:
    """Open the tracker; an absent one is tried again and again. See `pcmrs.devices.protocols.OpenDriver`.

    Args:
        devices: Only ``tracker``.
        settings: Whole configuration as plain data; ``ndi`` is read.
        clock: Clock of the machine.

    Raises:
        ConfigurationError: Another device is requested, the table ``ndi`` is wrong, or a tool definition is missing or
            has another hash.
    """
    check_devices("ndi", devices, "tracker")
    own = read_table(settings, "ndi", NdiSettings)
    yield {"tracker": NdiTracker(own, _tools(own), clock)}


def _tools(settings: NdiSettings) -> dict[str, bytes]:
    if settings.tools or settings.sha256:
        return read_tools(settings.tools, settings.sha256)
    if not _is_virtual(settings.device):
        text = f"ndi.tools is empty: name the SROM file of each body's tool, or {settings.device} tracks nothing."
        raise ConfigurationError(text, device=settings.device)
    return {body: placeholder(body) for body in VIRTUAL_BODIES}


def _is_virtual(device: str) -> bool:
    """Return True if a tracker at this address is virtual: on this machine, or on a pseudo-terminal."""
    host = device.rpartition(":")[0]
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost" or device.startswith("/dev/pts/")
