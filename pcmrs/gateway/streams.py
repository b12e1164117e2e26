"""Streams to clients: poses, the pointer tip, tool points from mixed reality, and markers on Lab Streaming Layer.

All but the mixed reality stream are in mm with 5 decimals and have no terminator.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from pcmrs.background import BackgroundTasks
from pcmrs.devices.lsl.markers import MarkerOutlet
from pcmrs.dispatcher import DispatcherListener
from pcmrs.gateway._adapter import Core
from pcmrs.gateway.grammar import TOOL_POINTS_PREFIX
from pcmrs.gateway.periodic_timer import Beats, PeriodicTask
from pcmrs.gateway.settings import GatewayConfig
from pcmrs.messages import DeviceEvent, Snapshot, Verdict
from pcmrs.spatial import Floats, Transform

REGISTERED = "111"

Send = Callable[[str, str, int], None]
"""Sends a text to a host and port."""


class Streams:
    """Streams that can be started and stopped; unknown values are left out.

    Args:
        core: The daemon, which has the poses.
        beats: Rate of the streams, in real time.
        config: Hosts, ports and rate.
        send: Sends one datagram.
        tasks: Owner of the running streams.
    """

    def __init__(self, core: Core, beats: Beats, config: GatewayConfig, send: Send, tasks: BackgroundTasks) -> None:
        self._core = core
        self._config = config
        self._send = send
        self._poses = PeriodicTask(beats, config.stream_rate_hz, self._send_poses, tasks)
        self._tip = PeriodicTask(beats, config.tip_rate_hz, self._send_tip, tasks)
        self._sent_to_unity: dict[str, str] = {}

    def start_poses(self) -> None:
        """Start the pose streams to visualization and mixed reality; the latter also gets plan and registration."""
        self._sent_to_unity.clear()
        self._poses.start()

    def stop_poses(self) -> None:
        """Stop the pose streams."""
        self._poses.stop()

    def start_tip(self) -> None:
        """Start the stream of the pointer tip to the planner."""
        self._tip.start()

    def stop_tip(self) -> None:
        """Stop the stream of the pointer tip."""
        self._tip.stop()

    def relay_tool_points(self, points_mm: Sequence[float]) -> None:
        """Forward two points of a tool pose (x1, y1, z1, x2, y2, z2), mm, from mixed reality to the planner."""
        self._to_planner(TOOL_POINTS_PREFIX + _join(points_mm, 5))

    def _send_poses(self) -> None:
        image_from_coil = self._core.tool_in_image()
        port = self._config.visualization.stream_port
        if image_from_coil is not None and port is not None:
            self._send(pose_message(image_from_coil), self._config.client_host, port)
        self._send_to_unity(image_from_coil)

    def _send_to_unity(self, image_from_coil: Transform | None) -> None:
        port = self._config.mixed_reality.stream_port
        if port is None:
            return
        texts = []
        if image_from_coil is not None and self._core.snapshot().branches.get("registration") == REGISTERED:
            texts.append(unity_message("crnt_", image_from_coil))
        texts += self._changed("trgt_", self._core.target_in_image())
        texts += self._changed("regi_", self._core.registration())
        for text in texts:
            self._send(text, self._config.mixed_reality_host, port)

    def _changed(self, prefix: str, pose: Transform | None) -> Iterable[str]:
        """Message of `pose`, if it differs from the last one."""
        text = "" if pose is None else unity_message(prefix, pose)
        changed = text != self._sent_to_unity.get(prefix, "")
        self._sent_to_unity[prefix] = text
        return [text] if changed and text else []

    def _send_tip(self) -> None:
        tip_in_image = self._core.tip_in_image()
        if tip_in_image is not None:
            self._to_planner(point_message(tip_in_image))

    def _to_planner(self, text: str) -> None:
        port = self._config.planner.stream_port
        if port is not None:
            self._send(text, self._config.client_host, port)


def pose_message(image_from_coil: Transform) -> str:
    """Return ``__msg_pose_`` with the position in mm and the quaternion x y z w."""
    return "__msg_pose_" + _join([*image_from_coil.translation * 1e3, *image_from_coil.quat_xyzw], 5)


def point_message(tip_in_image: Floats) -> str:
    """Return ``__msg_point_`` with the point (3,) in mm."""
    return "__msg_point_" + _join(tip_in_image * 1e3, 5)


def unity_message(prefix: str, pose: Transform) -> str:
    """Return the message of a pose in Unity's left-handed axes: x, z, y, -qx, -qz, -qy, qw.

    Swapping y and z mirrors space, and a mirrored rotation turns the other way.

    Args:
        prefix: Beginning of the message.
        pose: The pose, m.
    """
    x, y, z = pose.translation
    qx, qy, qz, qw = pose.quat_xyzw
    return prefix + _join([x, z, y, -qx, -qz, -qy, qw], 7)


def _join(numbers: Iterable[float], decimals: int) -> str:
    return "_".join(f"{number:.{decimals}f}" for number in numbers)


STOP = "stop"


class Markers(DispatcherListener):
    """Markers of every change of a state as ``branch:from->to``, every Stop as ``stop`` and every pulse as ``pulse:3``.

    The mark of a pulse comes when its operation has ended: the stimulator's driver marks the time of the pulse itself.

    Args:
        stream: Name of the stream.
        now: Present snapshot; changes from there on are marked.

    Raises:
        ConfigurationError: Lab Streaming Layer is not installed.
    """

    def __init__(self, stream: str, now: Snapshot) -> None:
        self._outlet = MarkerOutlet(stream)
        self._branches = now.branches

    def on_publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        """Mark changes of states, and pulses; never waits."""
        if isinstance(message, Snapshot):
            for branch, state in message.branches.items():
                before = self._branches.get(branch)
                if before != state:
                    self._outlet.push(f"{branch}:{before}->{state}")
            self._branches = message.branches
        elif isinstance(message, Verdict) and message.result and "pulse" in message.result:
            self._outlet.push(f"pulse:{message.result['pulse']}")

    def on_stop(self) -> None:
        """Mark a Stop."""
        self._outlet.push(STOP)
