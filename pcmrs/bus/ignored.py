"""What comes over the bus and is of no use: counted, and logged seldom, so that nobody fills the log from elsewhere."""

from __future__ import annotations

import logging
from typing import Final

from pcmrs.clock import SystemClock
from pcmrs.errors import PcmrsError

LOG_PERIOD: Final = 1.0
"""Between two lines of the log, s."""

_log = logging.getLogger(__name__)


class Ignored:
    """Takes messages that nobody can take.

    Attributes:
        count: How many since the start.
    """

    def __init__(self) -> None:
        self.count = 0
        self._told = 0
        self._clock = SystemClock()
        self._next_log = self._clock.monotonic()

    def take(self, key: str, error: PcmrsError) -> None:
        """Counts a message, and logs it unless another was logged just now. From any thread."""
        self.count += 1
        now = self._clock.monotonic()
        if now >= self._next_log:
            untold, self._told, self._next_log = self.count - self._told - 1, self.count, now + LOG_PERIOD
            others = f" ({untold} more since the last line)" if untold else ""
            _log.warning("Ignored a message on %s: %s%s", key, error.text, others)
