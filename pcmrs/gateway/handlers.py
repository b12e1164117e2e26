"""Handlers of the commands of one peer."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

from pcmrs.clock import Clock
from pcmrs.dispatcher.verdict_cache import id_reused
from pcmrs.errors import RefusalError
from pcmrs.gateway._adapter import Core
from pcmrs.gateway.commands import Action, PlanKind
from pcmrs.gateway.grammar import CommandOutcome, StringCommand, of_verdict
from pcmrs.gateway.pose_files import PoseFileWriter
from pcmrs.gateway.rejection_log import RejectionLog
from pcmrs.gateway.streams import Streams
from pcmrs.messages import Command
from pcmrs.messages.identity import Principal

LANDMARK, GRID_POSE = "landmark", "grid pose"
"""What the items of a series are."""

PAIR_WINDOW = 1.0
"""Limit of the time between rotation and translation of one pose, s of the machine."""


class NumberedSeries:
    """Items whose number is announced, and which are then sent one by one.

    Any error drops the series, so that the next one starts with an announcement.

    Args:
        item: What one of them is, for texts.
    """

    def __init__(self, item: str) -> None:
        self._item = item
        self._count: int | None = None
        self._items: dict[int, list[float]] = {}

    @property
    def collected(self) -> object:
        """Number and items of the open series, comparable with another; None if none is open."""
        return None if self._count is None else (self._count, self._items)

    def announce(self, count: int) -> None:
        """Begin a series of `count` items; an earlier one is dropped."""
        self._count = count
        self._items = {}

    def add(self, index: int, numbers: Sequence[float]) -> None:
        """Add an item.

        Args:
            index: Its index, from 0.
            numbers: Its position, m, and for a pose its quaternion.

        Raises:
            RefusalError: No series is announced, or the index lies outside it or was sent before.
        """
        if self._count is None:
            text = f"{self._item.capitalize()} {index} belongs to no series; announce their number first."
            raise RefusalError("no_series", text)
        if index >= self._count or index in self._items:
            fault = "came twice" if index in self._items else f"lies outside the {self._count} announced"
            text = f"{self._item.capitalize()} {index} {fault}; the series is dropped, send it again."
            self._count = None
            raise RefusalError("bad_series", text)
        self._items[index] = list(numbers)

    def finish(self) -> list[list[float]]:
        """End the series; return the numbers of its items, in order.

        Raises:
            RefusalError: No series is announced, or items are missing.
        """
        count, self._count = self._count, None
        if count is None:
            raise RefusalError("no_series", f"No {self._item} series is open; announce their number, then send them.")
        missing = sorted(set(range(count)) - set(self._items))
        if missing:
            raise RefusalError(
                "incomplete_series",
                f"Of {count} {self._item}s {missing} are missing; the series is dropped, send all of it again.",
                count=count,
                missing=missing,
            )
        return [self._items[index] for index in range(count)]


class PosePair:
    """Pose that is sent as a rotation and then, within `PAIR_WINDOW`, a translation."""

    def __init__(self) -> None:
        self._open: tuple[float, list[float]] | None = None

    @property
    def collected(self) -> object:
        """Rotation that waits, comparable with another; None if none does."""
        return None if self._open is None else self._open[1]

    def rotate(self, quat_xyzw: Sequence[float], now: float) -> None:
        """Begin a pair; a rotation that waits is replaced.

        Args:
            quat_xyzw: Unit quaternion, (4,).
            now: Present time, s.
        """
        self._open = (now, list(quat_xyzw))

    def translate(self, position: Sequence[float], now: float) -> dict[str, object]:
        """End the pair; return ``position``, m, and ``quat_xyzw``.

        Args:
            position: Position in m, (3,).
            now: Present time, s.

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
    """Lock that refuses approaches while the newest plan of a kind is not accepted.

    A client that ignores a refusal would otherwise move to the old target. All clients of one host share a lock:
    planner and control panel of one workstation use different sockets.
    """

    def __init__(self) -> None:
        self._attempts = 0
        self._pending: dict[PlanKind, int] = {}

    @property
    def held(self) -> bool:
        """True while the newest plan of some kind is not accepted."""
        return bool(self._pending)

    @property
    def newest(self) -> int:
        """Number of the newest attempt."""
        return self._attempts

    def attempt(self, kind: PlanKind) -> int:
        """Note that a plan of `kind` has begun; return its number."""
        self._attempts += 1
        self._pending[kind] = self._attempts
        return self._attempts

    def accept(self, kind: PlanKind, attempt: int) -> None:
        """Note that a plan was accepted; a newer one of its kind keeps the lock.

        Args:
            kind: Kind of the plan.
            attempt: Its number.
        """
        if self._pending.get(kind, attempt) <= attempt:
            self._pending.pop(kind, None)


Job = Callable[[], Awaitable[CommandOutcome]]

NO_SURGEON = (
    "A string command carries no name, and only the surgeon can state this: set gateway.surgeon, or state it in the "
    "console or with `pcmrs call`."
)
NOT_FOR_SURGEON = (
    "Only the surgeon can state this, and {peer!r} may not do so in the surgeon's name: state it in the console or "
    'with `pcmrs call`, or list "treat" in gateway.peers.{peer}.allow if the surgeon stands beside this peer.'
)

PARTS = {
    Action.ANNOUNCE_LANDMARKS: PlanKind.LANDMARKS,
    Action.ADD_LANDMARK: PlanKind.LANDMARKS,
    Action.PLAN_LANDMARKS: PlanKind.LANDMARKS,
    Action.OPEN_POSE: PlanKind.POSE,
    Action.PLAN_POSE: PlanKind.POSE,
}
"""Commands that are part of a plan."""


@dataclass(frozen=True, slots=True)
class Services:
    """Services that all peers share.

    Attributes:
        run: Unique id of this run of the gateway: the daemon remembers all commands, but a client's ids start again.
        surgeon: Name of the surgeon whose statements string commands may carry; empty for none.
    """

    run: str
    core: Core
    clock: Clock
    streams: Streams
    pose_files: PoseFileWriter
    refusals: RejectionLog
    surgeon: str = ""


class CommandHandlers:
    """The actions of one peer.

    Args:
        source: Source of its commands in the journal: peer and link.
        asker: User of its commands, and their role.
        services: Services that all peers share.
        lock: Plan lock of the peer's host, or its own if it signs.
        for_surgeon: True if it may state in the surgeon's name what only the surgeon can state.
    """

    def __init__(self, source: str, asker: Principal, services: Services, lock: PlanLock, *, for_surgeon: bool) -> None:
        self.source = source
        self._asker = asker
        self._for_surgeon = for_surgeon
        self._services = services
        self._core = services.core
        self._lock = lock
        self._stops = 0
        self._ends: dict[str, float | None] = {}
        self._landmarks = NumberedSeries(LANDMARK)
        self._grid = NumberedSeries(GRID_POSE)
        self._pair = PosePair()
        self._handlers: dict[Action, Callable[[StringCommand], CommandOutcome | Job]] = {
            Action.ANNOUNCE_LANDMARKS: self._announce_landmarks,
            Action.ADD_LANDMARK: self._add_landmark,
            Action.PLAN_LANDMARKS: self._plan_landmarks,
            Action.OPEN_POSE: self._open_pose,
            Action.PLAN_POSE: self._plan_pose,
            Action.ANNOUNCE_GRID: lambda request: self._done(
                request, lambda: self._grid.announce(int(request.values[0]))
            ),
            Action.ADD_GRID_POSE: self._add_grid_pose,
            Action.PLAN_GRID: self._plan_grid,
            Action.STOP: lambda request: lambda: self._stop(request),
            Action.READ_JOINTS: lambda request: self._numbers(request, self._core.joints()),
            Action.READ_FLANGE: self._read_flange,
            Action.KEEP_JOINTS: lambda request: lambda: self._keep_joints(request),
            Action.START_POSES: lambda request: self._done(request, services.streams.start_poses),
            Action.STOP_POSES: lambda request: self._done(request, services.streams.stop_poses),
            Action.START_TIP: lambda request: self._done(request, services.streams.start_tip),
            Action.STOP_TIP: lambda request: self._done(request, services.streams.stop_tip),
            Action.SAVE_PLACEMENT: lambda request: lambda: self._save_placement(request),
            Action.LOG_POSES: lambda request: self._done(request, services.pose_files.log_poses),
        }

    def prepare(self, request: StringCommand, arrived: float) -> CommandOutcome | Job:
        """Perform at once what need not wait, and return the rest as a job to run in its turn.

        Parts of a plan are collected here, on arrival, so that a motion that follows already sees the plan as begun.

        Args:
            request: The command.
            arrived: Time of its arrival, s of the machine's clock.
        """
        if request.spec.action is Action.SUBMIT:
            return lambda: self._submit(request, arrived)
        try:
            return self._handlers[request.spec.action](request)
        except RefusalError as refusal:
            return self.refused(request, refusal)

    def deny(self, request: StringCommand, refusal: RefusalError) -> CommandOutcome:
        """Refuse a command that is not prepared; if it is part of a plan, drop its parts, and let approaches wait.

        Args:
            request: The command.
            refusal: Why it is refused.
        """
        self._drop_parts(request)
        return self.refused(request, refusal)

    def deny_reused(self, request: StringCommand, before: StringCommand) -> CommandOutcome:
        """Refuse a command whose id has been used for another one; see `deny`.

        Args:
            request: The command.
            before: The other command.
        """
        if not request.repeats(before):  # a late copy of an earlier command must not break a plan that has begun since
            self._drop_parts(request)
        refusal = id_reused(self.source, str(request.id), before.spec.name)
        return self.rejected(request, refusal.refusal_code, refusal.text)

    def collected(self, request: StringCommand) -> object:
        """Return the parts of the plan that a command would end; None for another command, or if there are none."""
        parts = {
            Action.PLAN_LANDMARKS: self._landmarks.collected,
            Action.PLAN_POSE: self._pair.collected,
            Action.PLAN_GRID: self._grid.collected,
        }
        return parts.get(request.spec.action)

    def halt(self) -> None:
        """End commands of several steps after the present step, because of Stop."""
        self._stops += 1

    def note_end(self, command: Command) -> None:
        """Note that a step has been accepted just now: the loop may resume its command much later."""
        if command.id in self._ends:
            self._ends[command.id] = self._services.clock.monotonic()

    def accepted(self, request: StringCommand, *numbers: float) -> CommandOutcome:
        """Return the acceptance of a command that the gateway itself performs, with its results."""
        return CommandOutcome("accepted", request.spec.branch, self._state(request), numbers=numbers)

    def rejected(self, request: StringCommand, reason: str, text: str = "") -> CommandOutcome:
        """Return a refusal by the gateway because of other commands; each refusal of a motion is reported.

        Args:
            request: The command.
            reason: Code of the reason.
            text: Text of the reason.
        """
        return self._reject(request, reason, text or reason, each=request.spec.moves)

    def refused(self, request: StringCommand, refusal: RefusalError) -> CommandOutcome:
        """Return a refusal for a reason that was found elsewhere, such as the sender.

        Args:
            request: The command.
            refusal: Why it is refused.
        """
        return self._reject(request, refusal.refusal_code, refusal.text, each=False)

    def _reject(self, request: StringCommand, reason: str, text: str, *, each: bool) -> CommandOutcome:
        self._services.refusals.add(self.source, reason, f"{request.spec.name} was refused: {text}", each=each)
        return CommandOutcome("rejected", request.spec.branch, self._state(request), reason)

    def failed(self, request: StringCommand, reason: str) -> CommandOutcome:
        """Return the failure of a command that had begun.

        Args:
            request: The command.
            reason: Code of the reason.
        """
        return CommandOutcome("failed", request.spec.branch, self._state(request), reason)

    def _drop_parts(self, request: StringCommand) -> None:
        if request.spec.action in PARTS:
            self._lock.attempt(PARTS[request.spec.action])
            self._landmarks, self._pair = NumberedSeries(LANDMARK), PosePair()

    async def _submit(self, request: StringCommand, arrived: float) -> CommandOutcome:
        if request.spec.approaches and self._lock.held:
            return self.rejected(request, "plan_not_accepted")
        attempt = self._lock.newest
        outcome = await self._run_steps(request, request.spec.arguments(request.values), arrived)
        if request.spec.settles is not None and outcome.decision == "accepted":
            self._lock.accept(request.spec.settles, attempt)
        return outcome

    async def _run_steps(self, request: StringCommand, arguments: dict[str, Any], arrived: float) -> CommandOutcome:
        """Submit the operations in order; the first that is not accepted ends the command.

        The age of the first one counts from the arrival of the command, so that its wait here counts; that of each
        further one counts from the end of the one before, so that a loop that is held up in between counts.
        """
        outcome = self.accepted(request)
        stops, since = self._stops, arrived
        # Chosen by the states at the start: a step must not follow from what the one before has changed.
        states = self._core.snapshot().branches
        for number, step in enumerate([step for step in request.spec.steps if step.applies(states)]):
            if self._stops != stops:
                return self.failed(request, "stopped")
            if step.by_surgeon and not self._services.surgeon:
                return self.rejected(request, "no_surgeon", NO_SURGEON)
            if step.by_surgeon and not self._for_surgeon:
                return self.rejected(request, "not_allowed", NOT_FOR_SURGEON.format(peer=self._asker.user))
            given = {"surgeon": self._services.surgeon} if step.by_surgeon else arguments
            outcome, since = await self._operate(request, number, step.branch, step.operation, given, since)
            if outcome.decision != "accepted":
                break
        return outcome

    async def _operate(
        self,
        request: StringCommand,
        number: int,
        branch: str,
        operation: str,
        arguments: dict[str, Any],
        arrived: float | None = None,
    ) -> tuple[CommandOutcome, float]:
        """Perform one operation; return its outcome, and when it ended."""
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
        self._ends[unique] = None
        try:
            verdict = await self._core.submit(command, arrived=arrived)
        finally:
            ended = self._ends.pop(unique)
        if (verdict.branch, verdict.operation) != (branch, operation):
            # The daemon has recalled an earlier command: another one, or this one with other steps.
            raise id_reused(self.source, str(request.id), f"{verdict.branch}.{verdict.operation}")
        return of_verdict(verdict), self._services.clock.monotonic() if ended is None else ended

    def _announce_landmarks(self, request: StringCommand) -> CommandOutcome:
        self._lock.attempt(PlanKind.LANDMARKS)
        self._landmarks.announce(int(request.values[0]))
        return self.accepted(request)

    def _add_landmark(self, request: StringCommand) -> CommandOutcome:
        index, *point = request.values
        self._landmarks.add(int(index), [float(value) for value in point])
        return self.accepted(request)

    def _plan_landmarks(self, request: StringCommand) -> Job:
        attempt = self._lock.attempt(PlanKind.LANDMARKS)
        points = self._landmarks.finish()
        landmarks = [{"name": f"p{index}", "position": point} for index, point in enumerate(points)]
        return lambda: self._plan(request, PlanKind.LANDMARKS, attempt, "plan_landmarks", {"landmarks": landmarks})

    def _add_grid_pose(self, request: StringCommand) -> CommandOutcome:
        index, *numbers = request.values
        self._grid.add(int(index), [float(value) for value in numbers])
        return self.accepted(request)

    def _plan_grid(self, request: StringCommand) -> Job:
        poses = [{"position": each[:3], "quat_xyzw": each[3:]} for each in self._grid.finish()]
        return lambda: self._submit_grid(request, poses)

    async def _submit_grid(self, request: StringCommand, poses: list[dict[str, list[float]]]) -> CommandOutcome:
        outcome, _ = await self._operate(request, 0, request.spec.branch, "plan_grid", {"poses": poses})
        return outcome

    def _open_pose(self, request: StringCommand) -> CommandOutcome:
        self._lock.attempt(PlanKind.POSE)
        self._pair.rotate([float(value) for value in request.values], self._services.clock.monotonic())
        return self.accepted(request)

    def _plan_pose(self, request: StringCommand) -> Job:
        attempt = self._lock.attempt(PlanKind.POSE)
        now = self._services.clock.monotonic()
        pose = self._pair.translate([float(value) for value in request.values], now)
        return lambda: self._plan(request, PlanKind.POSE, attempt, "plan", pose)

    async def _plan(
        self, request: StringCommand, kind: PlanKind, attempt: int, operation: str, arguments: dict[str, Any]
    ) -> CommandOutcome:
        outcome, _ = await self._operate(request, 0, request.spec.branch, operation, arguments)
        if outcome.decision == "accepted":
            self._lock.accept(kind, attempt)
        return outcome

    async def _stop(self, request: StringCommand) -> CommandOutcome:
        stands = await self._core.stop(self.source)
        return self.accepted(request) if stands else self.failed(request, "hold_not_confirmed")

    def _read_flange(self, request: StringCommand) -> CommandOutcome:
        pose = self._core.flange_pose()
        return self._numbers(request, None if pose is None else [*pose.translation, *pose.quat_xyzw])

    async def _keep_joints(self, request: StringCommand) -> CommandOutcome:
        return self._numbers(request, await self._core.remember_initial_joints())

    def _numbers(self, request: StringCommand, numbers: list[float] | None) -> CommandOutcome:
        return self.rejected(request, "no_data") if numbers is None else self.accepted(request, *numbers)

    def _done(self, request: StringCommand, act: Callable[[], object]) -> CommandOutcome:
        act()
        return self.accepted(request)

    async def _save_placement(self, request: StringCommand) -> CommandOutcome:
        await self._services.pose_files.save_placement()
        return self.accepted(request)

    def _state(self, request: StringCommand) -> str:
        """State of the command's branch; the gateway's own services are always ready."""
        return self._core.snapshot().branches.get(request.spec.branch, "ready")
