"""The detector of the scene as a process: from depth images of a camera to scene events on the bus of a cell."""

from __future__ import annotations

import asyncio
import uuid
from collections import deque
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from pcmrs.bus import Bus
from pcmrs.clock import Clock, SystemClock
from pcmrs.errors import ConfigurationError
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.kinematics.zones import ToolShape
from pcmrs.messages import JointState, SceneEvent
from pcmrs.messages.identity import LOCAL
from pcmrs.messages.scene_event import BLIND, WATCHING
from pcmrs.scene.cameras.recorded import RecordedCamera, write_frames
from pcmrs.scene.depth_frame import DepthCamera, DepthFrame
from pcmrs.scene.detector import IntrusionDetector, SceneView
from pcmrs.scene.known_bodies import KnownBodies, Margins
from pcmrs.settings import Settings
from pcmrs.spatial import Floats
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.surface import read_surface

OpenCamera = Callable[[Callable[[], Floats | None]], DepthCamera]

LATENCIES: Final = 10_000
"""Number of newest latencies that are kept for the summary."""


class NewestJoints:
    """Newest measured joints of the arm.

    Args:
        clock: Clock of the machine.
        longest_age: Age from which the arm's place is not known any more, s.
    """

    def __init__(self, clock: Clock, longest_age: float) -> None:
        self._clock = clock
        self._longest_age = longest_age
        self._positions: Floats | None = None
        self._received = 0.0

    def take(self, _key: str, state: JointState) -> None:
        """Take joints from the bus."""
        self._positions, self._received = np.array(state.positions), self._clock.monotonic()

    def now(self) -> Floats | None:
        """Return the joints, rad; None if they are not known or too old."""
        is_old = self._clock.monotonic() - self._received > self._longest_age
        return None if is_old else self._positions


class DetectorSummary(msgspec.Struct, frozen=True, kw_only=True):
    """Summary of a detector's run.

    Attributes:
        frames: Number of images.
        intrusions: Number of tracks that were published.
        latency_p50_ms: Median time from an image to its events, ms.
        latency_p99_ms: 99th percentile of it, ms.
    """

    frames: int
    intrusions: int
    latency_p50_ms: float
    latency_p99_ms: float


class SceneNode:
    """Publisher of what a detector sees.

    Args:
        publish: Publishes an event under a relative key.
        user: Name in the certificate of this process, or `LOCAL`.
        settings: The whole configuration.
        camera: The depth camera.
        joints: Returns the newest joints of the arm.
        clock: Clock of the machine.
    """

    def __init__(
        self,
        publish: Callable[[str, Any], None],
        user: str,
        settings: Settings,
        camera: DepthCamera,
        joints: Callable[[], Floats | None],
        clock: Clock,
    ) -> None:
        self._publish = publish
        self._key = f"scene/{user}"
        self._own = settings.scene_camera
        self._camera = camera
        self._joints = joints
        self._clock = clock
        self._session = uuid.uuid4().hex
        self._detector = IntrusionDetector(self._own, camera.intrinsics, known_bodies(settings))
        self._latencies: deque[float] = deque(maxlen=LATENCIES)
        self._tracks: set[int] = set()
        self._frames = 0

    async def run(self) -> None:
        """Look at all images of the camera; ends with the last, if there is one."""
        async for frame in self._camera.frames():
            # In a thread: the loop goes on receiving joints.
            view = await asyncio.to_thread(self._detector.look, frame, self._joints())
            self._send(frame, view)

    def summary(self) -> DetectorSummary:
        """Return what was seen so far, and how fast."""
        found = np.array(self._latencies or (0.0,)) * 1e3
        return DetectorSummary(
            frames=self._frames,
            intrusions=len(self._tracks),
            latency_p50_ms=float(np.percentile(found, 50)),
            latency_p99_ms=float(np.percentile(found, 99)),
        )

    def _send(self, frame: DepthFrame, view: SceneView) -> None:
        if view.blind:
            self._event(frame, BLIND, reason=view.blind)
        else:
            for track in view.tracks:
                middle = track.cluster.middle.tolist()
                self._event(
                    frame,
                    self._own.label,
                    confidence=track.confidence,
                    track=track.number,
                    position=(middle[0], middle[1], middle[2]),
                    frame="robot_base",
                    region=track.cluster.zone,
                )
                self._tracks.add(track.number)
            self._event(frame, WATCHING)
        self._frames += 1
        self._latencies.append(self._clock.monotonic() - frame.captured)

    def _event(self, image: DepthFrame, label: str, **fields: Any) -> None:
        event = SceneEvent(
            source=self._own.source,
            label=label,
            captured=image.captured,
            sent=self._clock.monotonic(),
            session=self._session,
            **fields,
        )
        self._publish(self._key, event)


def known_bodies(settings: Settings) -> KnownBodies:
    """Return the models of arm, tool and body of a cell.

    Raises:
        ConfigurationError: The arm, a calibration or the surface cannot be used.
    """
    own, tool = settings.scene_camera, settings.procedure.zones.tool
    surface = read_surface(settings.procedure) if own.body is not None else None
    return KnownBodies(
        ArmModel(find_arm(settings.robot.model)),
        Mounting.read(settings.procedure.calibration).flange_from_tool_tip,
        ToolShape(tool.radius, tool.half_length),
        Margins(own.arm_margin, own.body_margin),
        None if surface is None or own.body is None else own.body.transform() @ surface.vertices,
    )


async def detect(settings: Settings, open_camera: OpenCamera, ended: asyncio.Event) -> DetectorSummary:
    """Run the detector of a cell until it shall end, or its camera has no more images.

    Args:
        settings: The whole configuration.
        open_camera: Opens the camera; its argument returns the newest joints, which a simulated camera shows.
        ended: Set when the detector shall end.

    Raises:
        BusError: The cell's daemon does not answer.
        ConfigurationError: A setting cannot be used.
        DeviceError: The camera does not answer.
        GeometryError: The background cannot be learned.
    """
    clock = SystemClock()
    bus = await Bus.open(settings.bus("client"))
    try:
        joints = NewestJoints(clock, settings.scene_camera.joints_age)
        bus.subscribe("state/joints", JointState, joints.take)
        credentials = bus.settings.credentials
        user = LOCAL if credentials is None else credentials.name
        with closing(open_camera(joints.now)) as camera:
            node = SceneNode(bus.publish, user, settings, camera, joints.now, clock)
            looking = asyncio.get_running_loop().create_task(node.run())
            ending = asyncio.get_running_loop().create_task(ended.wait())
            await asyncio.wait([looking, ending], return_when=asyncio.FIRST_COMPLETED)
            ending.cancel()
            if looking.done():
                looking.result()
            looking.cancel()
            await asyncio.gather(looking, ending, return_exceptions=True)
            return node.summary()
    finally:
        await bus.close()


def open_real_camera(settings: Settings) -> DepthCamera:
    """Open the camera of the table ``scene_camera``.

    Raises:
        ConfigurationError: The library of the camera is missing, or no file of images is configured.
        DeviceError: The camera does not answer.
        FileFormatError: The file of images cannot be read.
    """
    own, clock = settings.scene_camera, SystemClock()
    if own.driver == "recorded":
        if not own.file:
            raise ConfigurationError("scene_camera.file is empty: name a file of pcmrs scene --record.")
        return RecordedCamera(Path(own.file).expanduser(), clock)
    from pcmrs.scene.cameras.realsense import RealSenseCamera

    return RealSenseCamera(own, clock)


async def record(camera: DepthCamera, path: Path, count: int) -> int:
    """Write the next images of a camera to a file, and return their number.

    Args:
        camera: The camera.
        path: File to write, ending in ``.npz``.
        count: Number of images.
    """
    frames: list[DepthFrame] = []
    async for frame in camera.frames():
        frames.append(frame)
        if len(frames) >= count:
            break
    write_frames(path, camera.intrinsics, frames)
    return len(frames)
