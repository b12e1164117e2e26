"""One stream of the lab: found by its name, read without waiting, and found again when it returns."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
import structlog

from pcmrs.devices.lsl.library import load_lsl
from pcmrs.spatial import Floats

FORGOTTEN = 5.0
"""Time after which a stream that does not answer is forgotten, s."""

BUFFER = 10
"""Size of the library's buffer of unread samples, s; for a stream of markers, hundreds of markers."""

CHUNK_SIZE = 1 << 12
"""Number of samples that are read at once."""

log = structlog.get_logger(__name__)


class Inlet:
    """Reader of a stream that may be absent, end, and return; every method returns at once.

    If two streams have the same name, neither is read, because it is unclear which one is meant.

    Args:
        name: Name of the stream, without quotes.
        kind: Type of the stream, such as ``EMG`` or ``Markers``; empty for any.

    Attributes:
        info: Description of the stream that was found last, a new object each time; None before.
        problem: Reason why nothing is read now; empty while the stream is read.

    Raises:
        ConfigurationError: Lab Streaming Layer is not installed.
    """

    def __init__(self, name: str, kind: str = "") -> None:
        self._lsl = load_lsl()
        self._label = f"stream {name!r}" + (f" of type {kind!r}" if kind else "")
        wanted = f"name='{name}'" + (f" and type='{kind}'" if kind else "")
        self._resolver = self._lsl.ContinuousResolver(pred=wanted, forget_after=FORGOTTEN)
        self._inlet: Any = None
        self._uid = self._lost = ""
        self._retry_at = 0.0
        self.info: Any = None
        self.problem = f"The {self._label} has not been found; start its source"

    def pull(self) -> tuple[Any, Floats]:
        """Return the samples since the last call, (n, channels), and their times of this machine's clock, s, (n,).

        Numbers are an array; texts are bytes. Nothing is returned before the first estimate of the clock offset.
        """
        self._find_stream()
        if self._inlet is None:
            return [], np.empty(0)
        try:
            correction = self._inlet.time_correction(timeout=0.0)
            samples, times = self._inlet.pull_chunk(max_samples=CHUNK_SIZE, as_numpy=True)
        except self._lsl.util.TimeoutError:
            return [], np.empty(0)
        except RuntimeError as error:  # base of all errors of the library
            self._drop(f"is not sent any more ({error}); start its source again".replace(".)", ")"))
            self._lost, self._retry_at = self._uid, self._lsl.local_clock() + FORGOTTEN
            return [], np.empty(0)
        self.problem = ""
        return samples, times + correction

    def close(self) -> None:
        """End reading."""
        self._inlet = self._resolver = None

    def _find_stream(self) -> None:
        """Open the stream if exactly one is found, and drop one that has vanished."""
        found = {info.uid(): info for info in self._resolver.results()}
        if self._inlet is not None and self._uid not in found:
            self._drop("does not answer any more; check its source and the network")
        if self._lsl.local_clock() < self._retry_at:
            found.pop(self._lost, None)  # the resolver still remembers it, although its source may have ended
        if len(found) > 1:
            self._inlet = None
            self.problem = f"The {self._label} exists {len(found)} times; end all but one or configure another name"
        elif found and self._inlet is None:
            ((self._uid, self.info),) = found.items()
            self._open()

    def _open(self) -> None:
        self.problem = f"The {self._label} has been found; its clock is being compared with ours"
        log.info("lsl_stream_found", stream=self._label, host=self.info.hostname())
        with suppress(RuntimeError):  # a timeout, or an error that the next pull raises again
            self._inlet = self._lsl.StreamInlet(self.info, max_buflen=BUFFER, recover=False)
            self._inlet.open_stream(timeout=0.0)  # requests the data, so that none is missed from now on

    def _drop(self, why: str) -> None:
        self.problem = f"The {self._label} {why}"
        log.warning("lsl_stream_lost", reason=self.problem)
        self._inlet = None
