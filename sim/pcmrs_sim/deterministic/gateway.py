"""The gateway's string commands without sockets: datagrams go directly to its intake."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from uuid import uuid4

from pcmrs.background import BackgroundTasks, logged_as
from pcmrs.clock import Clock
from pcmrs.gateway.handlers import Services
from pcmrs.gateway.intake import Intake
from pcmrs.gateway.links import TASK_FAILED
from pcmrs.gateway.peer_session import ReplyChannel
from pcmrs.gateway.periodic_timer import beats_of
from pcmrs.gateway.pose_files import PoseFileWriter
from pcmrs.gateway.rejection_log import RejectionLog
from pcmrs.gateway.settings import GatewayConfig
from pcmrs.gateway.streams import Streams
from pcmrs.service.gateway_adapter import GatewayAdapter

LINK = "planner"
HOST = "127.0.0.1"


class SimulatedGateway:
    """The planner link of the gateway.

    Args:
        core: The daemon, as the gateway uses it.
        config: Settings of the links.
        clock: Clock of the daemon's host.
        folder: Folder of the pose files.
    """

    def __init__(self, core: GatewayAdapter, config: GatewayConfig, clock: Clock, folder: Path) -> None:
        self._tasks, self._jobs = (BackgroundTasks(logged_as(TASK_FAILED)) for _ in range(2))
        streams = Streams(core, beats_of(clock), config, _discard, self._tasks)
        pose_files = PoseFileWriter(core, clock, folder, self._tasks)
        refusals = RejectionLog(core, clock, self._tasks)
        self._intake = Intake(Services(uuid4().hex, core, clock, streams, pose_files, refusals), self._jobs, (HOST,))
        core.add_listener(self._intake)

    def receive(
        self, port: int, data: bytes, answer: Callable[[str], None], acknowledge: Callable[[str], None] | None
    ) -> None:
        """Take a datagram of the planner.

        Args:
            port: UDP port from which the planner sent it.
            data: Payload.
            answer: Called with the verdict.
            acknowledge: Called with the acknowledgement that old clients expect; None for other clients.
        """
        self._intake.receive(LINK, (HOST, port), False, data, ReplyChannel(verdict=answer, acknowledge=acknowledge))

    async def close(self) -> None:
        """End its tasks."""
        await self._jobs.close()
        await self._tasks.close()


def _discard(_text: str, _host: str, _port: int) -> None:
    """Drop a line of a stream: a simulated planner reads none."""
