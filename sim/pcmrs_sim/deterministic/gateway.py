"""The gateway's string commands without sockets: datagrams go straight to its intake."""

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
    """Takes the datagrams of the planner link.

    Args:
        core: The daemon.
        config: Of the links.
        clock: The machine's.
        folder: For records.
    """

    def __init__(self, core: GatewayAdapter, config: GatewayConfig, clock: Clock, folder: Path) -> None:
        self._tasks, self._jobs = (BackgroundTasks(logged_as(TASK_FAILED)) for _ in range(2))
        streams = Streams(core, beats_of(clock), config, _to_nobody, self._tasks)
        pose_files = PoseFileWriter(core, clock, folder, self._tasks)
        refusals = RejectionLog(core, clock, self._tasks)
        self._intake = Intake(Services(uuid4().hex, core, clock, streams, pose_files, refusals), self._jobs, (HOST,))
        core.add_listener(self._intake)

    def receive(
        self, port: int, data: bytes, answer: Callable[[str], None], acknowledge: Callable[[str], None] | None
    ) -> None:
        """Takes a datagram of the planner at `port`; its verdict goes to `answer`, old clients want the other."""
        self._intake.receive(LINK, (HOST, port), False, data, ReplyChannel(verdict=answer, acknowledge=acknowledge))

    async def close(self) -> None:
        """Ends what runs."""
        await self._jobs.close()
        await self._tasks.close()


def _to_nobody(_text: str, _host: str, _port: int) -> None:
    """Nobody looks at streams."""
