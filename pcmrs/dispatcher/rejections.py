"""How many rejections of a user the journal takes: whoever asks in vain without end does not fill the disk.

Commands that are accepted are not counted. A rejection beyond the limit is answered like any other, but leaves no row:
one row says how many there were.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final

from pcmrs.bucket import TokenBucket
from pcmrs.clock import Clock
from pcmrs.messages import Command, DeviceEvent, Reason
from pcmrs.messages.roles import PEOPLE

RATE_HZ: Final = 10.0
"""Rejections of one user per second that get a row each, in the long run."""
BURST: Final = 1000
"""Rejections of one user that get a row at once."""
USERS: Final = 16
"""Users with a limit of their own; the others share one."""
OTHERS: Final = "others"
PERIOD: Final = 10.0
"""Rejections without a row are counted in one after so long, s."""
TOO_MANY: Final = "too_many_rejections"
DROPPED: Final = "rejections_dropped"


class Rejections:
    """Decides which rejections get a row.

    Args:
        clock: The machine's.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._buckets: dict[str, TokenBucket] = {}
        self._dropped: dict[str, int] = {}
        self._tell: Callable[[DeviceEvent], object] | None = None
        self._timer: asyncio.TimerHandle | None = None

    def on_dropped(self, tell: Callable[[DeviceEvent], object]) -> None:
        """Has `tell` called with the number of rejections without a row, once in `PERIOD` while there are any."""
        self._tell = tell

    def limit(self, command: Command, reason: Reason) -> Reason | None:
        """Why a rejection for `reason` gets no row; None where it gets one."""
        if command.role not in PEOPLE:
            return None
        known = command.user in self._buckets or len(self._buckets) < USERS
        name = command.user if known else OTHERS
        bucket = self._buckets.setdefault(name, TokenBucket(RATE_HZ, BURST, self._clock))
        if bucket.take():
            return None
        self._dropped[name] = self._dropped.get(name, 0) + 1
        if self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(PERIOD, self.tell)
        wait = bucket.wait
        text = f"{reason.text} Commands of {command.user} were rejected more often than {RATE_HZ:g} times per second, "
        text += f"so this rejection is only counted: correct the command, and ask again in {wait:.1f} s."
        fields = {"rejected_for": reason.code, "limit_hz": RATE_HZ, "retry_after": wait}
        return Reason(code=TOO_MANY, text=text, fields=fields)

    def tell(self) -> None:
        """Tells of what has got no row since the last time."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        dropped, self._dropped = self._dropped, {}
        for user, count in dropped.items():
            text = f"{count} rejections of commands of {user} have no row: more than {RATE_HZ:g} per second."
            fields = {"user": user, "count": count, "limit_hz": RATE_HZ}
            if self._tell is not None:
                self._tell(DeviceEvent(device="dispatcher", code=DROPPED, text=text, fields=fields))
