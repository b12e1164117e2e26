"""Intel RealSense depth camera, through its own library. Not tested on hardware."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import numpy as np

from pcmrs.clock import Clock
from pcmrs.errors import ConfigurationError, DeviceError
from pcmrs.scene.camera_settings import SceneCameraSettings
from pcmrs.scene.depth_frame import DepthFrame, Intrinsics

PATIENCE_MS = 1000
"""Longest wait for an image, ms: a camera without images is silent, which the daemon finds before that."""


class RealSenseCamera:
    """`pcmrs.scene.depth_frame.DepthCamera` of a RealSense; images of the depth stream, not aligned to colour.

    Args:
        settings: Serial number, size and rate of the images.
        clock: Clock of the machine. An image counts as captured when the
            library delivers it.

    Raises:
        ConfigurationError: The library is not installed.
        DeviceError: There is no such camera, or it does not offer such images.
    """

    def __init__(self, settings: SceneCameraSettings, clock: Clock) -> None:
        try:
            import pyrealsense2
        except ModuleNotFoundError as error:
            text = f"The driver realsense needs the package {error.name}, which is not installed (docs/scene.md)."
            raise ConfigurationError(text, module=error.name) from None
        self._clock = clock
        self._pipeline: Any = pyrealsense2.pipeline()
        wanted: Any = pyrealsense2.config()
        if settings.serial:
            wanted.enable_device(settings.serial)
        rate = round(settings.rate_hz)
        wanted.enable_stream(pyrealsense2.stream.depth, settings.width, settings.height, pyrealsense2.format.z16, rate)
        try:
            profile = self._pipeline.start(wanted)
        except RuntimeError as error:
            text = f"The RealSense {settings.serial or '(any)'} does not start with {settings.width} x "
            text += f"{settings.height} at {rate} Hz: {error}. Look at its cable, serial number and modes."
            raise DeviceError(text, serial=settings.serial) from None
        self._scale = float(profile.get_device().first_depth_sensor().get_depth_scale())
        found = profile.get_stream(pyrealsense2.stream.depth).as_video_stream_profile().get_intrinsics()
        self.intrinsics = Intrinsics(
            width=found.width, height=found.height, fx=found.fx, fy=found.fy, cx=found.ppx, cy=found.ppy
        )

    def close(self) -> None:
        """Stop the camera."""
        self._pipeline.stop()

    async def frames(self) -> AsyncIterator[DepthFrame]:
        """Yield each new image; raises `DeviceError` if the camera sends none any more."""
        while True:
            try:
                frames = await asyncio.to_thread(self._pipeline.wait_for_frames, PATIENCE_MS)
            except RuntimeError as error:
                raise DeviceError(f"The RealSense sends no images: {error}. Look at its cable.") from None
            depth = frames.get_depth_frame()
            if depth:
                image = np.asarray(depth.get_data()).astype(np.float32) * np.float32(self._scale)
                yield DepthFrame(int(depth.get_frame_number()), self._clock.monotonic(), image)
