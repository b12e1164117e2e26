"""Interface of the gateway to the daemon."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from pcmrs.messages import Command, DeviceEvent, Snapshot, Verdict

if TYPE_CHECKING:
    from pcmrs.dispatcher import DispatcherListener
    from pcmrs.gateway.tracked_poses import TrackedPoses

    # Only for annotations: a planner shares this package's grammar and must not load NumPy for it.
    from pcmrs.spatial import Floats, Transform
    from pcmrs.workflows.data import PlacementData


class Core(Protocol):
    """The daemon behind the gateway. Lengths in m, angles in rad; methods that are not coroutines return at once."""

    async def submit(self, command: Command, *, arrived: float | None = None) -> Verdict:
        """Decide on one command and perform it; a rejection is a verdict, not an exception.

        Args:
            command: The command.
            arrived: Time of its arrival, s of the machine's monotonic clock; by default now.
        """

    async def stop(self, source: str) -> bool:
        """Stop everything and latch; return whether the robot has confirmed that it stands."""

    def report(self, event: DeviceEvent) -> None:
        """Journal and publish an event of the gateway, without waiting."""

    def add_listener(self, listener: DispatcherListener) -> None:
        """Notify a listener of every Stop and of everything that is published, synchronously."""

    def snapshot(self) -> Snapshot:
        """Return the state of all branches."""

    def joints(self) -> list[float] | None:
        """Return the newest measured joints, rad; None while the robot is not connected."""

    async def remember_initial_joints(self) -> list[float] | None:
        """Store the present joints as the initial ones, and return them when they are durable.

        Return None if there are none, if the arm moves or is near the body, which is no place to return to, or if the
        journal has failed.
        """

    def flange_pose(self) -> Transform | None:
        """``robot_base_from_flange`` of the measured joints."""

    def tool_in_image(self) -> Transform | None:
        """``image_from_coil`` as the tracker measured it; None unless fresh and registered."""

    def target_in_image(self) -> Transform | None:
        """``image_from_coil`` of the accepted plan."""

    def tip_in_image(self) -> Floats | None:
        """Tip of the pointer in the image, m, (3,); None unless fresh and registered."""

    def registration(self) -> Transform | None:
        """``body_ref_from_image`` of the accepted registration."""

    def data(self) -> PlacementData:
        """Return the data of the procedure."""

    def seen(self) -> dict[str, Transform]:
        """``tracker_from_body`` of each body that the tracker sees, if fresh: ``coil``, ``pointer``, ``body_ref``."""

    def tracked(self) -> TrackedPoses | None:
        """Return the measured poses of a pose log, newest of each; None unless fresh and registered."""
