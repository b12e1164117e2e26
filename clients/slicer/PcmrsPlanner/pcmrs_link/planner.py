"""What a planner asks of a cell, in mm and RAS: jobs of string commands, what they ended in, and which were refused."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .link import Link, Step
from .messages import Verdict, explain, metres
from .poses import Pose, PoseError, pose_of_line

ACTIONS = {
    "Connect robot": Step("rob_conn_onxxxxx", timeout=30.0),
    "Disconnect robot": Step("rob_conn_offxxxx", timeout=30.0),
    "Digitize all": Step("start_autodigitz", timeout=600.0),
    "Register": Step("start_registrati"),
    "Previous registration": Step("start_useprevreg"),
    "Approach": Step("execute_motionxx", timeout=120.0),
    "Confirm": Step("execute_confirmx", timeout=120.0),
    "Back off": Step("execute_bkoffset", timeout=120.0),
    "Home": Step("execute_homexxxx", timeout=240.0),
    "Restart procedure": Step("session_reinitxx"),
    "Show tool": Step("start_visualizex"),
    "Hide tool": Step("stop_visualizexx"),
    "Show tip": Step("tre_startcalcuxx"),
    "Hide tip": Step("tre_stopcalcuxxx"),
}
"""Jobs of one command, by the words on their buttons."""

HELLO = Step("get_jnt_angsxxxx", timeout=3.0)
PART = 5.0
"""Seconds for a part of a plan."""
KEPT = 50

Then = Callable[[Verdict], None]


@dataclass(frozen=True)
class Refusal:
    """What was not accepted: when (Unix seconds), which job, and why."""

    at: float
    title: str
    text: str


@dataclass(frozen=True)
class BranchState:
    """State of a branch in the last verdict about it, and when that came, by the link's clock."""

    state: str
    at: float


@dataclass(frozen=True)
class Placement:
    """What the tracker measured at the target: pose of the tool in the image, and its errors in mm and degrees."""

    pose: Pose
    translation_error: float
    rotation_error: float


class Planner:
    """Jobs of a workflow that are given to a link, with their results.

    Args:
        link: An open link.
        wall: Unix seconds, to tell people when.

    Attributes:
        known: State of each branch by the last verdict about it; other clients may have changed it since.
        refusals: The newest last.
        last: Title and sentence of the job that ended last.
        residual: Of the last registration accepted here, mm.
        placement: Of the last confirmation accepted here.
    """

    def __init__(self, link: Link, wall: Callable[[], float] = time.time) -> None:
        self.link = link
        self.known: dict[str, BranchState] = {}
        self.refusals: deque[Refusal] = deque(maxlen=KEPT)
        self.last: tuple[str, str] | None = None
        self.residual: float | None = None
        self.placement: Placement | None = None
        self._wall = wall

    def hello(self, then: Then = lambda _: None) -> None:
        """Request the joints: any verdict shows that the daemon accepts commands of this client."""
        self.link.begin("Connect", HELLO, then=self._answered("Connect", then, quiet=("no_data",)))

    def act(self, title: str, then: Then = lambda _: None) -> None:
        """Start one of `ACTIONS`. Raises `BusyError`."""
        self._begin(title, ACTIONS[title], then=then)

    def plan_landmarks(self, points: Sequence[Sequence[float]], then: Then = lambda _: None) -> None:
        """Plan landmarks at points in the image, (N, 3), mm RAS, in this order. Raises `BusyError`, `MessageError`."""
        parts = [Step("img_fid_pntxxxxx", (index, *metres(point)), PART) for index, point in enumerate(points)]
        first = Step("img_fid_numxxxxx", (len(points),), PART)
        self._begin("Plan landmarks", first, *parts, Step("img_fid_lastrecv"), then=then)

    def plan_tool(self, pose: Pose, then: Then = lambda _: None) -> None:
        """Plan the pose of the tool in the image, mm RAS, +z away from the body. Raises `BusyError`."""
        rotation = Step("target_rotxxxxxx", tuple(pose.quat_xyzw), PART)
        self._begin("Plan tool", rotation, Step("target_tslxxxxxx", tuple(metres(pose.position))), then=then)

    def relayed_tool(self, turn: float = 0.0) -> Pose:
        """The tool on the line of the two points that came last from mixed reality; see `pose_of_line`.

        Raises:
            PoseError: None have come, or they make no line.
        """
        seen = self.link.seen.get("tool_points")
        if seen is None or isinstance(seen.value, Pose):
            raise PoseError("No points have come from mixed reality.")
        return pose_of_line(seen.value[:3], seen.value[3:], turn)

    def digitize(self, index: int, then: Then = lambda _: None) -> None:
        """Digitize one landmark, counted from 0. Raises `BusyError`."""
        self._begin("Digitize", Step("img_dig_digitize", (index,), 90.0), then=then)

    def nudge(self, offset: Sequence[float], then: Then = lambda _: None) -> None:
        """Move the tool by an offset in its own frame, (3,), mm. Raises `BusyError`, `MessageError`."""
        self._begin("Nudge", Step("adjust_tranxxxxx", tuple(metres(offset)), 60.0), then=then)

    def stop(self, then: Then = lambda _: None) -> None:
        """Stop every motion and activity at once."""
        self.link.stop(self._answered("STOP", then))

    def _begin(self, title: str, *steps: Step, then: Then) -> None:
        self.link.begin(title, *steps, then=self._answered(title, then))

    def _answered(self, title: str, then: Then, quiet: Sequence[str] = ()) -> Then:
        def answered(verdict: Verdict) -> None:
            self._note(title, verdict, quiet)
            then(verdict)

        return answered

    def _note(self, title: str, verdict: Verdict, quiet: Sequence[str]) -> None:
        self.last = (title, explain(verdict))
        if verdict.branch:
            self.known[verdict.branch] = BranchState(verdict.state, self.link.clock())
        if not verdict.accepted and verdict.reason not in quiet:
            self.refusals.append(Refusal(self._wall(), title, explain(verdict)))
        if verdict.accepted and title in ("Register", "Previous registration") and verdict.results:
            self.residual = verdict.results[0]
        if verdict.accepted and title == "Confirm" and len(verdict.results) == 9:
            x, y, z, *rest = verdict.results
            pose = Pose.near([1e3 * x, 1e3 * y, 1e3 * z], rest[:4])
            self.placement = Placement(pose, rest[4], rest[5])
