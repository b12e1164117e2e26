"""Watches the physical side of a session: the arm at every step, the driver's calls, the operators' verdicts.

It shares no code with the dispatcher and does not query it. It compares the arm, the calls that reach the driver, and
the verdicts that reach operators with the published messages and the journal.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

from pcmrs.fsm.blueprint import OperationSpec
from pcmrs.messages import ActiveActivity, Command, DeviceEvent, Running, Snapshot, Verdict
from pcmrs.spatial import Transform
from pcmrs_lab.campaign.explore.invariants import BRAKED_ANYHOW, braked
from pcmrs_lab.campaign.explore.view import REGISTERING, View, refuses_the_id

MOVED = 0.002
"""Displacement at which a resting joint counts as moved, rad."""
UNASKED = 0.03
"""Displacement of an arm at rest that must become a Stop, rad: more than the limits of node and daemon."""
RESTED = 2.0
"""Time at rest after which node and daemon know the posture, too, s: two joint states, and a blocked loop."""
DECIDED = 20.0
"""Time within which the operation of an event is decided, while any operation runs, s."""
ID = re.compile("[0-9a-f]{32}")
"""Ids of the commands that the gateway makes for clients without ids."""
NEVER_FOR_EVENTS = ("busy", "queue_full", "latched", "stopped")
"""Reasons for which no event may be rejected, since the event has happened already."""
BEGINS_WITHIN = 1.2
"""Time within which a motion of a client without ids begins after its arrival, s: 0.1 s, a blocked loop, planning."""
CHECKED_WITHIN = 0.11
"""Time within which the checks of what moves or acts begin after its command has arrived, s: 0.1 s, and rounding."""
OF_A_CLIENT = re.compile(r"[0-9a-f]{32}-(\d+)-0")
"""Ids that the gateway makes of the id of a string command, for its first operation."""
SECOND = 0.4
"""Time after which clients take a second datagram for their next acknowledgement, s."""
HELD = 0.1
"""Tolerance beyond the deadman, s: 25 ms, and the delay with which the simulation sees it."""
NEAR = 0.05
"""Distance between the face of the tool and the body in front of it that counts as near, m: less than a standoff."""
INWARDS = 0.002
"""Travel of a near tool towards the body that counts, m."""
AT_THE_BODY = ("standoff", "placed", "following", "guided")
"""States of the placement in which the tool is where the plan puts it."""


class Watcher:
    """Watcher of one session.

    Args:
        view: Published messages and journal.
        break_: Called with the name of a violated invariant, and a description.
        deadman: Deadman of the nodes, s.
    """

    def __init__(self, view: View, break_: Callable[[str, str], None], deadman: float) -> None:
        self._view = view
        self._break = break_
        self._deadman = deadman
        self._posture: Sequence[float] | None = None
        self._settling = False
        self._stood: Sequence[float] | None = None
        self._rests_since = 0.0
        self._displaced_at: float | None = None
        self._allowed: dict[str, float] = {}
        self._newest: tuple[str, float] | None = None
        self._last_hold = float("-inf")
        self._ending: set[str] = set()
        self._lost_at: float | None = None
        self._seen: Sequence[float] | None = None
        self._node_excused = float("-inf")
        self._reference_moved: float | None = None
        self._undecided: dict[str, float] = {}
        self._dangers: set[str] = set()
        self._tool_at: tuple[str | None, str | None] | None = None
        self._arrived: dict[str, float] = {}
        self._commands: dict[str, float] = {}
        self._planned: list[tuple[str, float, float]] = []
        self._blocked: list[tuple[float, float]] = []
        self._emitted: dict[str, float] = {}
        self._not_ready_since: float | None = 0.0
        self._tool: Transform | None = None
        self._inwards = 0.0
        self._guided = self._must_latch = False
        self._decisions: dict[tuple[str, str], str] = {}

    # -- the arm and its driver ----------------------------------------------------------------------

    def step(self, now: float, positions: Sequence[float], *, at_rest: bool, braking: bool, relieving: bool) -> None:
        """Check the simulated arm after a step.

        Args:
            now: Time of the simulation, s.
            positions: Positions of the joints, rad.
            at_rest: True if the arm rests.
            braking: True if the arm brakes.
            relieving: True if the arm moves to relieve a force.
        """
        if self._view.motion.holds or now < self._view.by_hand or relieving:
            self._posture = None
        elif self._posture is not None:
            moved = max(abs(one - other) for one, other in zip(positions, self._posture, strict=True))
            if moved > MOVED:
                text = f"A joint is {moved:.4f} rad from where the arm stood, and no motion is allowed."
                self._break("the_arm_stays", text)
        elif at_rest and not self._settling:
            self._posture = tuple(positions)
        if relieving or not self._nothing_runs():
            self._forget_standing(now)
        else:
            self._check_unasked(now, positions, at_rest=at_rest)
        # A hold of an arm at rest is a reference without length: it counts as motion only if a joint moves.
        seen, self._seen = self._seen, None if self._lost_at is None else tuple(positions)
        moves = seen is not None and max(abs(one - other) for one, other in zip(positions, seen, strict=True)) > 0.0
        commanded = moves and not (at_rest or braking) and now >= self._view.by_hand
        if self._lost_at is not None and commanded and now > self._held_by(self._lost_at):
            text = f"The daemon ended {now - self._lost_at:.3f} s ago, and the arm moves."
            self._break("silence_is_held", text)
        self._check_undecided(now)
        self._check_emitted(now)

    def _check_unasked(self, now: float, positions: Sequence[float], *, at_rest: bool) -> None:
        """Check that displacement of an arm that nothing moves becomes a Stop, also displacement by hand."""
        if self._stood is None:
            if not at_rest or self._settling:
                self._rests_since = now
            elif now - self._rests_since > RESTED:
                self._stood = tuple(positions)
            return
        displacement = max(abs(one - other) for one, other in zip(positions, self._stood, strict=True))
        if displacement < UNASKED:
            self._displaced_at = None
        elif self._displaced_at is None:
            self._displaced_at = now
        elif now - self._displaced_at > BRAKED_ANYHOW:
            text = (
                f"A joint was displaced by {displacement:.3f} rad {now - self._displaced_at:.1f} s ago while nothing "
            )
            self._break("unasked_motion_is_a_stop", text + "ran, and Stop is not latched.")

    def _nothing_runs(self) -> bool:
        """Return whether the arm is connected, may move, and nothing runs that explains a displacement."""
        snapshot = self._view.snapshot
        if snapshot is None or snapshot.latched or snapshot.running or self._view.motion.holds or self._view.excused:
            return False
        return snapshot.branches.get("robot") == "1"

    def _forget_standing(self, now: float) -> None:
        self._stood = self._displaced_at = None
        self._rests_since = now

    def must_stay_away(self, now: float) -> bool:
        """Return whether the tool may come no nearer to the body: no approach is possible, and the arm has braked."""
        since = self._not_ready_since
        return since is not None and now - since > braked(self._view) and now >= self._view.by_hand

    def take_tool(self, tracker_from_tool: Transform, *, near: bool) -> None:
        """Check a step of a tool that must stay away from the body.

        Args:
            tracker_from_tool: True pose of the tool, whose +z points away from the body.
            near: True if it is within `NEAR` of the body.
        """
        if self._tool is not None and near:
            step = self._tool.translation - tracker_from_tool.translation
            self._inwards = max(0.0, self._inwards + float(step @ tracker_from_tool.rotation[:, 2]))
        self._tool = tracker_from_tool
        if self._inwards > INWARDS:
            text = f"The tool has come {1e3 * self._inwards:.1f} mm nearer to the body, and no approach is possible."
            self._break("the_tool_comes_near_only_when_ready", text)

    def forget_tool(self) -> None:
        """Restart with the next step of the tool: it has stopped, or may approach."""
        self._tool, self._inwards = None, 0.0

    def _note_readiness(self, snapshot: Snapshot | None, now: float) -> None:
        if snapshot is not None and not snapshot.latched and self._may_approach(snapshot):
            self._not_ready_since = None
        elif self._not_ready_since is None:
            self._not_ready_since = now

    def _may_approach(self, snapshot: Snapshot) -> bool:
        """Return whether the states permit any operation that approaches the body, whatever the placement is."""
        branches = self._view.blueprint.branches.values()
        approaches = [spec for branch in branches for spec in branch.operations.values() if _approaches(spec)]
        return not approaches or any(
            all(snapshot.branches.get(branch) in states for branch, states in spec.requires.items())
            for spec in approaches
        )

    def begins(self, method: str, now: float) -> None:
        """Check a motion that the driver has been commanded to begin.

        Args:
            method: Method of the driver.
            now: Time of the simulation, s.
        """
        self._posture = None
        self._guided = method == "begin_servo"
        if now < self._view.by_hand:
            return
        name, since = self._newest or ("nothing", float("-inf"))
        if self._last_hold > since:
            text = f"robot.{method} came {now - self._last_hold:.3f} s after a hold, and {name} began before that."
            self._break("nothing_begins_after_its_hold", text)
        spec = self._spec(name)
        if spec is None or not _approaches(spec) or self._reference_moved is None:
            return
        hold_on_its_way = self._last_hold < self._reference_moved and now - self._reference_moved < braked(self._view)
        if not hold_on_its_way:
            self._break("approaches_only_when_ready", f"{name} moves, and the reference has moved since registration.")

    def held(self, now: float) -> None:
        """Record that the driver must hold.

        The hold by which an activity ends comes while the motion that ends it waits for that.
        """
        snapshot = self._view.snapshot
        if not self._ending or snapshot is None or snapshot.latched:
            self._last_hold = now
        if not self._view.motion.holds:
            self._settling = False

    def excuse_node(self, until: float) -> None:
        """Excuse the node until a time, s: it is blocked or absent."""
        self._node_excused = max(self._node_excused, until)

    def node_is_back(self, now: float) -> None:
        """End the excuse: the node has been started again."""
        self._node_excused = now

    def _held_by(self, since: float) -> float:
        return max(since, self._node_excused) + self._deadman + HELD

    # -- messages of the daemon ------------------------------------------------------------------------

    def begin_run(self, snapshot: Snapshot) -> None:
        """Check the first snapshot of a started daemon."""
        if self._must_latch and not snapshot.latched:
            self._break("a_crash_in_motion_latches", "The daemon ended while the arm was guided, and starts unlatched.")
        self._must_latch = False
        self._lost_at = None
        self._undecided.clear()
        self._dangers.clear()
        self._ending.clear()
        self._allowed.clear()
        self._arrived.clear()
        self._commands.clear()
        self._planned.clear()
        self._blocked.clear()
        self._emitted.clear()
        self._reference_moved = None
        self._tool_at = None

    def lose_daemon(self, now: float, *, crash: bool) -> None:
        """Record that the daemon has ended.

        Args:
            now: Time of the simulation, s.
            crash: True if it was killed.
        """
        snapshot = self._view.snapshot
        self._note_readiness(None, now)
        if crash:
            self._lost_at = now
            self._must_latch = self._guided and snapshot is not None and self._guides(snapshot)
        self._undecided.clear()

    def take_snapshot(self, snapshot: Snapshot, now: float) -> None:
        """Check a published snapshot.

        Args:
            snapshot: Snapshot.
            now: Time of the simulation, s.
        """
        self._note_readiness(snapshot, now)
        if not self._nothing_runs():
            self._forget_standing(now)
        self._note_motions(snapshot, now)
        placement = snapshot.branches.get("placement")
        ids = (snapshot.plan, snapshot.registration)
        if placement not in AT_THE_BODY:
            self._tool_at = None
        elif self._tool_at is None:
            self._tool_at = ids
        elif ids != self._tool_at:
            text = (
                f"placement is {placement} under plan and registration {ids}; the tool went there by {self._tool_at}."
            )
            self._break("the_tool_is_at_its_plan", text)

    def take_event(self, event: DeviceEvent, now: float) -> None:
        """Record a published event.

        Args:
            event: Event of a device.
            now: Time of the simulation, s.
        """
        if event.code == "activity_ended":
            self._ending.discard(event.device.removeprefix("activity:"))
        if event.code == "reference_moved" and self._states("registration") in ("110", "111"):
            self._reference_moved = now
        branches = self._view.blueprint.branches.values()
        if any((spec := branch.operations.get(event.code)) is not None and spec.event for branch in branches):
            self._undecided[event.code] = now
            if event.danger:
                self._dangers.add(event.code)

    def take_verdict(self, verdict: Verdict) -> None:
        """Check a published verdict."""
        self._commands.pop(_command_key(verdict.id), None)
        name, spec = f"{verdict.branch}.{verdict.operation}", self._spec(f"{verdict.branch}.{verdict.operation}")
        if spec is None:
            return
        if spec.event:
            code = verdict.reason.code if verdict.reason is not None else ""
            if verdict.decision == "rejected" and code in NEVER_FOR_EVENTS:
                self._break("no_event_is_turned_away", f"{name} was rejected {code}.")
            self._undecided.pop(verdict.operation, None)
            self._dangers.discard(verdict.operation)
        if verdict.decision == "accepted":
            if spec.moves and self._newest is not None and self._newest[0] == name:
                self._settling = False
            if verdict.branch == "registration" and verdict.operation in REGISTERING:
                self._reference_moved = None

    def _note_motions(self, snapshot: Snapshot, now: float) -> None:
        running = {
            each.id: f"{each.branch}.{each.operation}"
            for each in snapshot.running
            if self._view.blueprint.branches[each.branch].operations[each.operation].moves
        }
        self._ending |= {each.name for each in snapshot.activities if self._moves(each)}
        going_on = {f"{each.branch}:{each.name}": f"{each.branch}:{each.name}" for each in snapshot.activities}
        before = self._view.before
        known = set() if before is None else {each.id for each in before.running}
        for each in snapshot.running:
            if each.id not in known:
                self._check_in_time(each, now)
        for key, name in running.items():
            if key not in self._allowed:
                self._check_beginning(key, name, now)
        for key, name in (running | going_on).items():
            if key not in self._allowed:
                self._newest, self._settling = (name, now), True
        self._allowed = {key: self._allowed.get(key, now) for key in running | going_on}

    def _check_beginning(self, key: str, name: str, now: float) -> None:
        if self._dangers:
            text = f"{name} begins, and {', '.join(sorted(self._dangers))} is not decided."
            self._break("dangers_are_decided_first", text)
        since = self._arrived.pop(name, now) if ID.fullmatch(key) else now
        if now - since > BEGINS_WITHIN:
            text = f"{name} begins {now - since:.3f} s after its command has arrived."
            self._break("motions_begin_in_time", text)

    def _check_in_time(self, running: Running, now: float) -> None:
        """Check that an operation that moves or acts began soon after its command arrived, without planning."""
        name = f"{running.branch}.{running.operation}"
        since, spec = self._commands.pop(_command_key(running.id), None), self._spec(name)
        if since is None or spec is None or not (spec.moves or spec.affects_patient):
            return
        planned = sum(duration for planned, at, duration in self._planned if planned == name and at >= since)
        blocked = sum(duration for at, duration in self._blocked if at >= since)
        if now - since > CHECKED_WITHIN + planned + blocked:
            text = (
                f"{name} begins {now - since:.3f} s after its command has arrived, of which {planned:.3f} s planning."
            )
            self._break("motions_begin_in_time", text)

    def _check_emitted(self, now: float) -> None:
        snapshot = self._view.snapshot
        if snapshot is None or snapshot.latched or snapshot.branches.get("robot") != "1" or self._view.excused:
            self._emitted.clear()
        for event, since in self._emitted.items():
            if now - since > BRAKED_ANYHOW:
                text = f"A device reported {event} {now - since:.1f} s ago, and Stop was not latched since."
                self._break("every_reported_danger_is_a_stop", text)

    def _check_undecided(self, now: float) -> None:
        for code, since in self._undecided.items():
            if now - since > DECIDED and not self._view.excused:
                self._break("no_event_is_lost", f"{code} was reported {now - since:.1f} s ago and is not decided.")

    # -- answers to people ------------------------------------------------------------------------

    def answered(self, command: Command, verdict: Verdict) -> None:
        """Check a verdict that has reached the operator who sent the command.

        Args:
            command: Command of the operator.
            verdict: Verdict that was received.
        """
        about = (verdict.branch, verdict.operation)
        if about != (command.branch, command.operation):
            text = f"{command.branch}.{command.operation} got the verdict on {'.'.join(about)}: {verdict.decision}."
            self._break("answers_are_about_the_command", text)
        if not refuses_the_id(verdict):
            self._decisions[command.source, command.id] = verdict.decision

    def arrived(self, name: str, now: float) -> None:
        """Record that a command without an id has arrived at a link.

        Args:
            name: Operation that it leads to, ``branch.operation``.
            now: Time of the simulation, s.
        """
        self._arrived[name] = now

    def command_arrived(self, key: str, now: float) -> None:
        """Record that a command with an id has arrived at the daemon for the first time.

        Args:
            key: Id of a command on the bus, or id of a client's string command.
            now: Time of its arrival, s: a message on the bus arrives even if the event loop is blocked.
        """
        self._commands.setdefault(key, now)

    def planning(self, name: str, now: float, duration: float) -> None:
        """Record that the planning process works on an operation.

        Args:
            name: Operation, ``branch.operation``.
            now: Time at which it starts, s.
            duration: Duration, s.
        """
        self._planned.append((name, now, duration))

    def daemon_blocked(self, now: float, duration: float) -> None:
        """Record that the event loop of the daemon is blocked.

        Args:
            now: Time at which that starts, s.
            duration: Duration, s.
        """
        self._blocked.append((now, duration))

    def emitted(self, event: DeviceEvent, now: float) -> None:
        """Record a danger event that a device has reported to its node.

        Args:
            event: Event of the device.
            now: Time of the simulation, s.
        """
        if event.danger:
            self._emitted.setdefault(f"{event.device} {event.code}", now)

    def check_second_datagram(self, after: float) -> None:
        """Check the delay of the second datagram after the acknowledgement, s."""
        if after > SECOND:
            self._break("no_second_is_late", f"The second datagram was sent {after:.3f} s after the acknowledgement.")

    def poses_end(self, fresh: bool) -> None:
        """Check that the daemon accepts poses again when no fault has been present for some time."""
        if not fresh:
            self._break("poses_go_on", "The tracker has sent good poses for seconds, and the daemon takes none.")

    def check_rows(self, decision_of: Callable[[str, str], str | None]) -> None:
        """Compare the verdicts that operators received with the journal.

        Args:
            decision_of: Returns the journalled decision on a source and an id.
        """
        for (source, command), decision in self._decisions.items():
            found = decision_of(source, command)
            if decision in ("accepted", "failed") and found != decision:
                self._break("acknowledged_rows_last", f"{command} was reported as {decision}; the journal has {found}.")

    # -- helpers -------------------------------------------------------------------------------------

    def _states(self, branch: str) -> str:
        snapshot = self._view.snapshot
        return "" if snapshot is None else snapshot.branches.get(branch, "")

    def _spec(self, name: str) -> OperationSpec | None:
        branch, _, operation = name.partition(".")
        found: Mapping[str, OperationSpec] = (
            self._view.blueprint.branches[branch].operations if branch in self._view.blueprint.branches else {}
        )
        return found.get(operation)

    def _guides(self, snapshot: Snapshot) -> bool:
        return any(self._moves(each) for each in snapshot.activities)

    def _moves(self, ongoing: ActiveActivity) -> bool:
        spec = self._view.blueprint.branches[ongoing.branch].activities.get(ongoing.state)
        return spec is not None and spec.moves


def _command_key(identifier: str) -> str:
    """Return the id that the client has given to a command."""
    match = OF_A_CLIENT.fullmatch(identifier)
    return identifier if match is None else match[1]


def _approaches(spec: OperationSpec) -> bool:
    return spec.moves and "registration" in spec.requires
