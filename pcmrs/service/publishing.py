"""Messages and answers of the daemon on the bus."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.bus import KEYS, Bus, Empty, KeyTable
from pcmrs.clock import Clock
from pcmrs.devices.link import Link
from pcmrs.dispatcher import Dispatcher
from pcmrs.failpoints import failpoint
from pcmrs.journal import JournalReader
from pcmrs.journal.rows import encode_row
from pcmrs.messages import (
    Command,
    DeviceEvent,
    DryRunRequest,
    DryRunResult,
    Flags,
    JournalPage,
    JournalQuery,
    Message,
    NextStep,
    NextStepRequest,
    Snapshot,
    Target,
    Verdict,
)
from pcmrs.messages.health import Health
from pcmrs.messages.setup import ProcedureDataView, Setup
from pcmrs.service import _setup_view
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData

LARGEST_PAGE = 500
PAGE_BYTES = 1024 * 1024
"""Size of the rows on a page of the journal, bytes as they are stored; more are on the next page."""
HEALTH_PERIOD = 5.0
"""Period of the messages on the daemon's health, s of the machine."""


class Publishing:
    """Publisher of snapshots, flags, events and data of the procedure on the bus."""

    def __init__(self, bus: Link) -> None:
        self._bus = bus
        self._data: PlacementData | None = None
        self._shown: dict[str, Message] = {}

    def publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        """Publish a message of the dispatcher."""
        failpoint("service.before_publish")
        if isinstance(message, Snapshot):
            self._bus.publish("state/fsm", message)
            self._bus.publish("state/flags", Flags(sequence=message.sequence, flags=message.flags))
        else:
            self._bus.publish("state/event", message)

    def publish_data(self, cell: Cell, data: PlacementData) -> None:
        """Publish the data of the procedure that have changed.

        Args:
            cell: The cell.
            data: Present data of the procedure.
        """
        if data is self._data:
            return
        self._data = data
        registration = data.registered.body_ref_from_image if data.registered is not None else None
        self._publish_new("state/target", Target(plan=data.plan_id, pose=data.plan, body_ref_from_image=registration))
        self._publish_new("state/data", _setup_view.gathered(cell, data))
        epoch = data.newest_epoch()
        if epoch is not None:
            self._publish_new("state/epoch", epoch)

    def _publish_new(self, key: str, message: Message) -> None:
        if self._shown.get(key) != message:
            self._shown[key] = message
            self._bus.publish(key, message)


def answer_queries(
    bus: Bus,
    dispatcher: Dispatcher[Cell, PlacementData],
    journal: JournalReader,
    health: Callable[[], Health],
    setup: Callable[[], Setup],
    gathered: Callable[[], ProcedureDataView],
) -> None:
    """Serve the read-only queries below ``svc/``.

    Files are read one at a time in another thread: several of them would keep the interpreter from the loop.

    Args:
        bus: The bus.
        dispatcher: The dispatcher.
        journal: Reader of the journal.
        health: Returns the present health.
        setup: Reads how the cell is set up from files. Its first result counts until the daemon ends.
        gathered: Returns the present data of the procedure.
    """
    shown: list[Setup] = []
    files = asyncio.Lock()

    async def snapshot(_key: str, _request: Empty) -> Snapshot:
        return dispatcher.snapshot()

    async def keys(_key: str, _request: Empty) -> KeyTable:
        return KeyTable(prefix=bus.prefix, keys=KEYS)

    async def well(_key: str, _request: Empty) -> Health:
        return health()

    async def data(_key: str, _request: Empty) -> ProcedureDataView:
        return gathered()

    async def laid_out(key: str, _request: Empty) -> Setup:
        user = key.rpartition("/")[2]
        async with files:
            if not shown:
                shown.append(await asyncio.to_thread(setup))
        return msgspec.structs.replace(shown[0], user=user, role=bus.settings.role_of(user))

    async def checked(key: str, question: DryRunRequest) -> DryRunResult:
        user = key.rpartition("/")[2]
        command = Command(
            id=uuid.uuid4().hex,
            branch=question.branch,
            operation=question.operation,
            source=f"bus:{user}",
            user=user,
            role=bus.settings.role_of(user),
            arguments=question.arguments,
        )
        return await dispatcher.dry_run(command)

    async def following(_key: str, question: NextStepRequest) -> NextStep:
        return dispatcher.next_step(question.operation)

    async def page(_key: str, query: JournalQuery) -> JournalPage:
        async with files:
            return await asyncio.to_thread(journal_page, journal.path, query)

    bus.serve("svc/snapshot", Empty, snapshot, reading=True)
    bus.serve("svc/setup/*", Empty, laid_out, reading=True)
    bus.serve("svc/data", Empty, data, reading=True)
    bus.serve("svc/check/*", DryRunRequest, checked, reading=True)
    bus.serve("svc/next", NextStepRequest, following, reading=True)
    bus.serve("svc/keys", Empty, keys, reading=True)
    bus.serve("svc/health", Empty, well, reading=True)
    bus.serve("svc/journal", JournalQuery, page, reading=True)


async def publish_health(bus: Link, health: Callable[[], Health], clock: Clock) -> None:
    """Publish the daemon's health periodically, for recordings of the session; until cancelled.

    Args:
        bus: The bus.
        health: Returns the present health.
        clock: The machine's clock.
    """
    while True:
        bus.publish("state/health", health())
        await clock.sleep(HEALTH_PERIOD)


def journal_page(path: Path, query: JournalQuery) -> JournalPage:
    """Return a page of the journal. It opens its own connection, since it runs beside the event loop.

    A page has as many rows as fit into `PAGE_BYTES`, but one at least.

    Args:
        path: Journal file.
        query: Rows of the page.
    """
    most = max(1, min(query.limit, LARGEST_PAGE))
    backwards = query.before is not None
    rows: list[dict[str, Any]] = []
    size = 0
    with JournalReader(path) as journal:
        found = journal.read(after=query.after, before=query.before, first=most, last=most if backwards else None)
        for row in reversed(list(found)) if backwards else found:
            size += len(encode_row(row.row))
            if rows and size > PAGE_BYTES:
                break
            rows.append(msgspec.to_builtins(row))
    return JournalPage(rows=rows[::-1] if backwards else rows)
