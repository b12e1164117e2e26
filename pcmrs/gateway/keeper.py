"""Has the counters of signed peers written by a thread of its own: the event loop never waits for the disk."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

from pcmrs.gateway.counters import CounterFile


class CounterKeeper:
    """Writes whatever waits, with one wait for the disk; newer counters of a peer stand for older ones.

    Args:
        file: Used by the thread only from now on, until this is closed.
        failed: Called in the event loop with the error of every write that failed.
    """

    def __init__(self, file: CounterFile, failed: Callable[[OSError], None]) -> None:
        self._file = file
        self._failed = failed
        self._loop = asyncio.get_running_loop()
        self._newest = dict(file.kept)
        self._waiting: list[asyncio.Future[None]] = []
        self._due = False
        self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="pcmrs-peer-counters", daemon=True)
        self._thread.start()

    def note(self, peer: str, counter: int) -> None:
        """Has a peer's newest counter written; nobody waits for it."""
        with self._changed:
            self._note(peer, counter)

    def keep(self, peer: str, counter: int) -> asyncio.Future[None]:
        """The same; the future is done when the disk has it, in the order of the calls, or has the `OSError`."""
        kept: asyncio.Future[None] = self._loop.create_future()
        with self._changed:
            self._note(peer, counter)
            self._waiting.append(kept)
        return kept

    async def close(self) -> None:
        """Ends when what was noted is written; who waits still is cancelled."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        await asyncio.to_thread(self._thread.join)

    def _note(self, peer: str, counter: int) -> None:
        self._newest[peer] = counter
        self._due = True
        self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._due or self._closing)
                if not self._due:
                    return
                newest, waiting = dict(self._newest), self._waiting
                self._waiting, self._due = [], False
            self._loop.call_soon_threadsafe(self._tell, waiting, self._write(newest))

    def _write(self, newest: dict[str, int]) -> OSError | None:
        try:
            self._file.write(newest)
        except OSError as error:
            return error
        return None

    def _tell(self, waiting: list[asyncio.Future[None]], error: OSError | None) -> None:
        if error is not None:
            self._failed(error)
        for kept in waiting:
            if kept.done():
                continue  # its time was up
            if self._closing:
                kept.cancel()
            elif error is None:
                kept.set_result(None)
            else:
                kept.set_exception(error)
