"""Plans that arrive in several datagrams, as transactions: complete and consistent, or dropped."""

from __future__ import annotations

from collections.abc import Sequence

from pcmrs.errors import RefusalError
from pcmrs.gateway.commands import Plan

PAIR_WINDOW = 1.0
"""Seconds of the machine between rotation and translation of one pose."""


class LandmarkSeries:
    """Landmarks announced by their number and then sent one by one.

    Whatever breaks the series drops it, so the next one starts with an announcement.
    """

    def __init__(self) -> None:
        self._count: int | None = None
        self._points: dict[int, list[float]] = {}

    def announce(self, count: int) -> None:
        """Begins a series of `count` landmarks; one begun before is dropped."""
        self._count = count
        self._points = {}

    def add(self, index: int, point: Sequence[float]) -> None:
        """Adds the landmark `index`, counted from 0, at `point` in the image, m, (3,).

        Raises:
            RefusalError: No series is announced, or the index lies outside it or came before.
        """
        if self._count is None:
            raise RefusalError("no_series", f"Landmark {index} belongs to no series; announce their number first.")
        if index >= self._count or index in self._points:
            fault = "came twice" if index in self._points else f"lies outside the {self._count} announced"
            self._count = None
            raise RefusalError("bad_series", f"Landmark {index} {fault}; the series is dropped, send it again.")
        self._points[index] = list(point)

    def finish(self) -> list[dict[str, object]]:
        """Ends the series: its landmarks by name and position, in order.

        Raises:
            RefusalError: No series is announced, or landmarks are missing.
        """
        count, self._count = self._count, None
        if count is None:
            raise RefusalError("no_series", "No landmark series is open; announce their number, then send them.")
        missing = sorted(set(range(count)) - set(self._points))
        if missing:
            raise RefusalError(
                "incomplete_series",
                f"Of {count} landmarks {missing} are missing; the series is dropped, send all of it again.",
                count=count,
                missing=missing,
            )
        return [{"name": f"p{index}", "position": self._points[index]} for index in range(count)]


class PosePair:
    """A pose sent as a rotation and then, within `PAIR_WINDOW`, a translation."""

    def __init__(self) -> None:
        self._open: tuple[float, list[float]] | None = None

    def rotate(self, quat_xyzw: Sequence[float], now: float) -> None:
        """Begins a pair at `now` (s); a rotation that waited is replaced."""
        self._open = (now, list(quat_xyzw))

    def translate(self, position: Sequence[float], now: float) -> dict[str, object]:
        """Ends the pair at `now` (s): position in m and ``quat_xyzw``.

        Raises:
            RefusalError: No rotation waits, or it is older than the window.
        """
        opened, self._open = self._open, None
        if opened is None:
            raise RefusalError("no_rotation", "The translation came without a rotation; send the rotation first.")
        began, quat_xyzw = opened
        if now - began > PAIR_WINDOW:
            raise RefusalError(
                "rotation_too_old",
                f"The rotation came {now - began:.2f} s before its translation, the limit is {PAIR_WINDOW:g} s; "
                "send both again.",
                age=now - began,
                limit=PAIR_WINDOW,
            )
        return {"position": list(position), "quat_xyzw": quat_xyzw}


class PlanLock:
    """Holds approaches back while the newest plan of a kind is not accepted.

    A client that ignores a refusal would otherwise move to the old target. All clients of one host share a lock:
    planner and control panel of one workstation use different sockets.
    """

    def __init__(self) -> None:
        self._attempts = 0
        self._pending: dict[Plan, int] = {}

    @property
    def held(self) -> bool:
        """Whether the newest plan of some kind is not accepted."""
        return bool(self._pending)

    @property
    def newest(self) -> int:
        """Number of the newest attempt."""
        return self._attempts

    def attempt(self, kind: Plan) -> int:
        """Notes that a plan of `kind` began; returns its number."""
        self._attempts += 1
        self._pending[kind] = self._attempts
        return self._attempts

    def accept(self, kind: Plan, attempt: int) -> None:
        """Notes that `kind` is settled up to `attempt`; a newer one keeps the lock."""
        if self._pending.get(kind, attempt) <= attempt:
            self._pending.pop(kind, None)
