"""What the gateway does with each command of one peer."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

from pcmrs.clock import Clock
from pcmrs.errors import RefusalError
from pcmrs.gateway.adapter import Core
from pcmrs.gateway.commands import Action, Plan, Step
from pcmrs.gateway.grammar import Request
from pcmrs.gateway.outcome import Outcome, of_verdict
from pcmrs.gateway.pose_files import PoseFileWriter
from pcmrs.gateway.rejection_log import RejectionLog
from pcmrs.gateway.streams import Streams
from pcmrs.messages import Command
from pcmrs.messages.identity import Principal

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


Job = Callable[[], Awaitable[Outcome]]

PARTS = {
    Action.ANNOUNCE_LANDMARKS: Plan.LANDMARKS,
    Action.ADD_LANDMARK: Plan.LANDMARKS,
    Action.PLAN_LANDMARKS: Plan.LANDMARKS,
    Action.OPEN_POSE: Plan.POSE,
    Action.PLAN_POSE: Plan.POSE,
}
"""Commands that are a part of a plan."""


@dataclass(frozen=True, slots=True)
class Services:
    """What all peers share.

    Attributes:
        run: Unique to one opening of the gateway: the daemon remembers commands for ever, a client's ids start anew.
    """

    run: str
    core: Core
    clock: Clock
    streams: Streams
    pose_files: PoseFileWriter
    refusals: RejectionLog


class CommandHandlers:
    """The actions of one peer.

    Args:
        source: Who the peer is and which way it came, as the daemon records it.
        asker: Who the peer is, and what it may do.
        services: What all peers share.
        lock: The plan lock of the peer's host, or its own when it signs.
    """

    def __init__(self, source: str, asker: Principal, services: Services, lock: PlanLock) -> None:
        self.source = source
        self._asker = asker
        self._services = services
        self._core = services.core
        self._lock = lock
        self._stops = 0
        self._landmarks = LandmarkSeries()
        self._pair = PosePair()
        self._handlers: dict[Action, Callable[[Request], Outcome | Job]] = {
            Action.ANNOUNCE_LANDMARKS: self._announce_landmarks,
            Action.ADD_LANDMARK: self._add_landmark,
            Action.PLAN_LANDMARKS: self._plan_landmarks,
            Action.OPEN_POSE: self._open_pose,
            Action.PLAN_POSE: self._plan_pose,
            Action.STOP: lambda request: lambda: self._stop(request),
            Action.READ_JOINTS: lambda request: self._numbers(request, self._core.joints()),
            Action.READ_FLANGE: self._read_flange,
            Action.KEEP_JOINTS: lambda request: self._numbers(request, self._core.remember_initial_joints()),
            Action.START_POSES: lambda request: self._done(request, services.streams.start_poses),
            Action.STOP_POSES: lambda request: self._done(request, services.streams.stop_poses),
            Action.START_TIP: lambda request: self._done(request, services.streams.start_tip),
            Action.STOP_TIP: lambda request: self._done(request, services.streams.stop_tip),
            Action.SAVE_PLACEMENT: lambda request: lambda: self._save_placement(request),
            Action.LOG_POSES: lambda request: self._done(request, services.pose_files.log_poses),
        }

    def prepare(self, request: Request, arrived: float) -> Outcome | Job:
        """Does at once what needs no waiting, and returns the rest as a job to run in its turn.

        Parts of a plan are collected here, on arrival, so that a motion behind them already sees the plan as begun.

        Args:
            request: The command.
            arrived: When it came, s of the machine's clock.
        """
        if request.spec.action is Action.SUBMIT:
            return lambda: self._submit(request, arrived)
        try:
            return self._handlers[request.spec.action](request)
        except RefusalError as refusal:
            return self.refused(request, refusal)

    def deny(self, request: Request, refusal: RefusalError) -> Outcome:
        """Refuses what is not even prepared; of a plan, all that was collected is dropped, and approaches wait."""
        if request.spec.action in PARTS:
            self._lock.attempt(PARTS[request.spec.action])
            self._landmarks, self._pair = LandmarkSeries(), PosePair()
        return self.refused(request, refusal)

    def halt(self) -> None:
        """Ends commands of several steps after the step under way, as Stop demands."""
        self._stops += 1

    def accepted(self, request: Request, *numbers: float) -> Outcome:
        """The acceptance of a command that the gateway itself performs."""
        return Outcome("accepted", request.spec.branch, self._state(request), numbers=numbers)

    def rejected(self, request: Request, reason: str, text: str = "") -> Outcome:
        """The gateway's own refusal, because of what else runs or waits; each one of a motion is reported."""
        return self._reject(request, reason, text or reason, each=request.spec.moves)

    def refused(self, request: Request, refusal: RefusalError) -> Outcome:
        """A refusal for a reason found elsewhere, such as who asks."""
        return self._reject(request, refusal.refusal_code, refusal.text, each=False)

    def _reject(self, request: Request, reason: str, text: str, *, each: bool) -> Outcome:
        self._services.refusals.add(self.source, reason, f"{request.spec.name} was refused: {text}", each=each)
        return Outcome("rejected", request.spec.branch, self._state(request), reason)

    def failed(self, request: Request, reason: str) -> Outcome:
        """A command that was begun and broke."""
        return Outcome("failed", request.spec.branch, self._state(request), reason)

    async def _submit(self, request: Request, arrived: float) -> Outcome:
        if request.spec.approaches and self._lock.held:
            return self.rejected(request, "plan_not_accepted")
        attempt = self._lock.newest
        outcome = await self._run_steps(request, request.spec.arguments(request.values), arrived)
        if request.spec.settles is not None and outcome.decision == "accepted":
            self._lock.accept(request.spec.settles, attempt)
        return outcome

    async def _run_steps(self, request: Request, arguments: dict[str, Any], arrived: float) -> Outcome:
        """Submits the operations in order; the first that is not accepted ends the command.

        The first one is as old as the command, so that its wait here counts; each further one begins with the end of
        the one before.
        """
        outcome = self.accepted(request)
        stops = self._stops
        for number, step in enumerate(step for step in request.spec.steps if self._applies(step)):
            if self._stops != stops:
                return self.failed(request, "stopped")
            since = arrived if number == 0 else None
            outcome = await self._operate(request, number, step.branch, step.operation, arguments, since)
            if outcome.decision != "accepted":
                break
        return outcome

    def _applies(self, step: Step) -> bool:
        return step.only_in is None or self._core.snapshot().branches.get(step.branch) in step.only_in

    async def _operate(
        self,
        request: Request,
        number: int,
        branch: str,
        operation: str,
        arguments: dict[str, Any],
        arrived: float | None = None,
    ) -> Outcome:
        unique = f"{self._services.run}-{request.id}-{number}" if request.id is not None else uuid4().hex
        command = Command(
            id=unique,
            branch=branch,
            operation=operation,
            source=self.source,
            user=self._asker.user,
            role=self._asker.role,
            arguments=arguments,
        )
        verdict = await self._core.submit(command, arrived=arrived)
        if (verdict.branch, verdict.operation) != (branch, operation):
            # The daemon recalled an earlier command: another one, or this one when it took other steps.
            text = f"#{request.id} has been {verdict.branch}.{verdict.operation}; give each command an id of its own."
            raise RefusalError("id_reused", text, id=request.id)
        return of_verdict(verdict)

    def _announce_landmarks(self, request: Request) -> Outcome:
        self._lock.attempt(Plan.LANDMARKS)
        self._landmarks.announce(int(request.values[0]))
        return self.accepted(request)

    def _add_landmark(self, request: Request) -> Outcome:
        index, *point = request.values
        self._landmarks.add(int(index), [float(value) for value in point])
        return self.accepted(request)

    def _plan_landmarks(self, request: Request) -> Job:
        attempt = self._lock.attempt(Plan.LANDMARKS)
        landmarks = self._landmarks.finish()
        return lambda: self._plan(request, Plan.LANDMARKS, attempt, "plan_landmarks", {"landmarks": landmarks})

    def _open_pose(self, request: Request) -> Outcome:
        self._lock.attempt(Plan.POSE)
        self._pair.rotate([float(value) for value in request.values], self._services.clock.monotonic())
        return self.accepted(request)

    def _plan_pose(self, request: Request) -> Job:
        attempt = self._lock.attempt(Plan.POSE)
        now = self._services.clock.monotonic()
        pose = self._pair.translate([float(value) for value in request.values], now)
        return lambda: self._plan(request, Plan.POSE, attempt, "plan", pose)

    async def _plan(
        self, request: Request, kind: Plan, attempt: int, operation: str, arguments: dict[str, Any]
    ) -> Outcome:
        outcome = await self._operate(request, 0, request.spec.branch, operation, arguments)
        if outcome.decision == "accepted":
            self._lock.accept(kind, attempt)
        return outcome

    async def _stop(self, request: Request) -> Outcome:
        stands = await self._core.stop(self.source)
        return self.accepted(request) if stands else self.failed(request, "hold_not_confirmed")

    def _read_flange(self, request: Request) -> Outcome:
        pose = self._core.flange_pose()
        return self._numbers(request, None if pose is None else [*pose.translation, *pose.quat_xyzw])

    def _numbers(self, request: Request, numbers: list[float] | None) -> Outcome:
        return self.rejected(request, "no_data") if numbers is None else self.accepted(request, *numbers)

    def _done(self, request: Request, act: Callable[[], object]) -> Outcome:
        act()
        return self.accepted(request)

    async def _save_placement(self, request: Request) -> Outcome:
        await self._services.pose_files.save_placement()
        return self.accepted(request)

    def _state(self, request: Request) -> str:
        """State of the command's branch; the gateway's own services have none but ready."""
        return self._core.snapshot().branches.get(request.spec.branch, "ready")
