"""Table of the string commands: their payloads, their operations, and the groups that a signed peer may be allowed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import PureWindowsPath
from typing import Any

from pcmrs.errors import ConfigurationError

Value = int | float | str
Arguments = Callable[[tuple[Value, ...]], dict[str, Any]]

CLOUD = 100
"""Number of points of the skin that one click takes from a sliding tip, as the public daemon does."""

APPROACHES = frozenset({"approach", "confirm", "nudge"})


class TokenType(Enum):
    """Type of one token of a payload."""

    COUNT = auto()  # 1 to 3 decimal digits
    NUMBER = auto()  # finite decimal number
    PATH = auto()  # everything up to the terminator


class Action(Enum):
    """Action of the gateway for a command."""

    SUBMIT = auto()
    ANNOUNCE_LANDMARKS = auto()
    ADD_LANDMARK = auto()
    PLAN_LANDMARKS = auto()
    OPEN_POSE = auto()
    PLAN_POSE = auto()
    ANNOUNCE_GRID = auto()
    ADD_GRID_POSE = auto()
    PLAN_GRID = auto()
    STOP = auto()
    READ_JOINTS = auto()
    READ_FLANGE = auto()
    KEEP_JOINTS = auto()
    START_POSES = auto()
    STOP_POSES = auto()
    START_TIP = auto()
    STOP_TIP = auto()
    SAVE_PLACEMENT = auto()
    LOG_POSES = auto()


class Second(Enum):
    """Kind of the second datagram that clients expect after the acknowledgement."""

    RESIDUAL = auto()  # one number, mm
    VALUES = auto()  # numbers, each followed by a separator


class PlanKind(Enum):
    """Kinds of plan that clients send."""

    LANDMARKS = auto()
    POSE = auto()


@dataclass(frozen=True, slots=True)
class CommandStep:
    """One operation of the workflow, which is left out in some states.

    Attributes:
        branch: Branch of the operation.
        operation: Name of the operation.
        only_in: States of the branch in which it is submitted; None for all.
        not_while: Branch and state in which it is left out, if the workflow has them; None for nothing.
        by_surgeon: True if its argument is the name of the surgeon, whom only the configuration knows. A
            signed peer needs the group `TREAT` for it.
    """

    branch: str
    operation: str
    only_in: tuple[str, ...] | None = None
    not_while: tuple[str, str] | None = None
    by_surgeon: bool = False

    def applies(self, states: Mapping[str, str]) -> bool:
        """Return true if it is submitted in a joint state.

        Args:
            states: State of every branch that the workflow has.
        """
        wanted = self.only_in is None or states.get(self.branch) in self.only_in
        return wanted and (self.not_while is None or states.get(self.not_while[0]) != self.not_while[1])


@dataclass(frozen=True, slots=True)
class Spec:
    """One command.

    Attributes:
        name: Exactly 16 characters.
        branch: The branch that a verdict about it names.
        steps: Operations submitted in order; the first that is not accepted ends the command.
        arguments: The operations' arguments from the payload's values.
        second: The second datagram that clients without verdict replies expect.
        settles: Kind of plan that counts as accepted with this command, though the command is not a plan itself.
    """

    name: str
    branch: str
    action: Action = Action.SUBMIT
    payload: tuple[TokenType, ...] = ()
    steps: tuple[CommandStep, ...] = ()
    arguments: Arguments = lambda _: {}
    second: Second | None = None
    settles: PlanKind | None = None

    @property
    def moves(self) -> bool:
        """True if it moves the arm; such a command begins in time or never."""
        return any(step.branch == "placement" for step in self.steps)

    @property
    def approaches(self) -> bool:
        """True if it may move the tool towards the plan; such a command waits for an accepted plan."""
        return any(step.branch == "placement" and step.operation in APPROACHES for step in self.steps)


def _submit(
    name: str,
    *operations: str | CommandStep,
    payload: tuple[TokenType, ...] = (),
    arguments: Arguments = lambda _: {},
    second: Second | None = None,
    settles: PlanKind | None = None,
) -> Spec:
    steps = tuple(item if isinstance(item, CommandStep) else _step(item) for item in operations)
    branch = steps[-1].branch
    return Spec(name, branch, payload=payload, steps=steps, arguments=arguments, second=second, settles=settles)


def _step(name: str) -> CommandStep:
    branch, operation = name.split(".")
    return CommandStep(branch, operation)


def _index(values: tuple[Value, ...]) -> dict[str, Any]:
    return {"index": values[0]}


def _surface(values: tuple[Value, ...]) -> dict[str, Any]:
    """Base name of a path on the client's machine, Windows or not; its folders mean nothing here."""
    return {"surface": PureWindowsPath(str(values[0])).name}


_XYZ = (TokenType.NUMBER,) * 3
_INDEX = (TokenType.COUNT,)
_BACK_OFF_UNLESS_RETRACTED = CommandStep(
    "placement", "back_off", only_in=("unknown", "standoff", "placed", "following", "guided", "replanned", "held")
)
_LOCATE_IF_UNKNOWN = CommandStep("placement", "locate", only_in=("unknown",))
_BACK_OFF_IF_KNOWN = CommandStep("placement", "back_off", not_while=("placement", "unknown"))
_CONFIRM_CLEAR_IF_UNKNOWN = CommandStep("treatment", "confirm_clear", only_in=("unknown",), by_surgeon=True)
_REINIT_UNLESS_UNKNOWN = tuple(
    CommandStep(branch, "reinit", not_while=("treatment", "unknown")) for branch in ("registration", "toolplan")
)
_REOPEN_IF_ALL_DIGITIZED = CommandStep("digitization", "redigitize_one", only_in=("1",))

_SPECS = (
    Spec("img_fid_numxxxxx", "registration", Action.ANNOUNCE_LANDMARKS, _INDEX),
    Spec("img_fid_pntxxxxx", "registration", Action.ADD_LANDMARK, (TokenType.COUNT, *_XYZ)),
    Spec("img_fid_lastrecv", "registration", Action.PLAN_LANDMARKS),
    _submit("start_autodigitz", "digitization.digitize_all"),
    _submit(
        "img_dig_digitize", _REOPEN_IF_ALL_DIGITIZED, "digitization.digitize_one", payload=_INDEX, arguments=_index
    ),
    _submit("img_dig_prevxxxx", "digitization.reuse_previous"),
    _submit("img_dig_prevhilg", "digitization.reuse_previous_except", payload=_INDEX, arguments=_index),
    _submit("start_registrati", "registration.register", second=Second.RESIDUAL),
    _submit("start_useprevreg", "registration.use_previous", second=Second.RESIDUAL, settles=PlanKind.LANDMARKS),
    Spec("target_rotxxxxxx", "toolplan", Action.OPEN_POSE, (TokenType.NUMBER,) * 4),
    Spec("target_tslxxxxxx", "toolplan", Action.PLAN_POSE, _XYZ),
    # The ordered grid, for panels that can be changed.
    Spec("grid_numxxxxxxxx", "mapping", Action.ANNOUNCE_GRID, _INDEX),
    Spec("grid_posexxxxxxx", "mapping", Action.ADD_GRID_POSE, (TokenType.COUNT, *(TokenType.NUMBER,) * 7)),
    Spec("grid_lastrecvxxx", "mapping", Action.PLAN_GRID),
    _submit("grid_aimxxxxxxxx", "toolplan.aim", settles=PlanKind.POSE),
    _submit("grid_performxxxx", "mapping.perform"),
    _submit("grid_skipxxxxxxx", "mapping.skip"),
    _submit("grid_repeatxxxxx", "mapping.repeat"),
    _submit("locate_armxxxxxx", "placement.locate"),
    _submit("icp_digitizexxxx", "digitization.digitize_surface", arguments=lambda _: {"points": CLOUD, "slide": True}),
    _submit("icp_pointxxxxxxx", "digitization.digitize_surface"),
    _submit("icp_clear_prevxx", "digitization.clear_surface_point"),
    _submit("icp_clear_allxxx", "digitization.clear_surface"),
    _submit("icp_registerxxxx", "registration.refine", payload=(TokenType.PATH,), arguments=_surface),
    Spec("tre_startcalcuxx", "gateway", Action.START_TIP),
    Spec("tre_stopcalcuxxx", "gateway", Action.STOP_TIP),
    Spec("get_jnt_angsxxxx", "robot", Action.READ_JOINTS, second=Second.VALUES),
    Spec("get_eff_posexxxx", "robot", Action.READ_FLANGE, second=Second.VALUES),
    Spec("get_jnt_setinitx", "robot", Action.KEEP_JOINTS, second=Second.VALUES),
    _submit("execute_motionxx", "placement.approach"),
    _submit("execute_confirmx", "placement.confirm"),
    _submit(
        "end_session_back",
        _BACK_OFF_UNLESS_RETRACTED,
        "placement.to_initial",
        "registration.reinit",
        "toolplan.reinit",
    ),
    _submit("execute_backinit", "placement.to_initial"),
    # Nothing moves before somebody has looked where the arm is; the next one then backs off.
    _submit("execute_bkoffset", _LOCATE_IF_UNKNOWN, _BACK_OFF_IF_KNOWN),
    _submit("execute_homexxxx", "placement.home"),
    _submit("adjust_tranxxxxx", "placement.nudge", payload=_XYZ, arguments=lambda v: {"translation": list(v)}),
    _submit("adjust_oriexxxxx", "placement.nudge", payload=_XYZ, arguments=lambda v: {"rotation_zyx": list(v)}),
    # Where nobody has said whether anything is in the bone, a session begins with that.
    _submit("session_reinitxx", _CONFIRM_CLEAR_IF_UNKNOWN, *_REINIT_UNLESS_UNKNOWN),
    Spec("stop_now_xxxxxxx", "robot", Action.STOP),
    _submit("rob_conn_onxxxxx", "robot.connect"),
    _submit("rob_conn_offxxxx", "robot.disconnect"),
    Spec("start_visualizex", "gateway", Action.START_POSES),
    Spec("stop_visualizexx", "gateway", Action.STOP_POSES),
    Spec("save_planandreal", "gateway", Action.SAVE_PLACEMENT),
    Spec("save_continupose", "gateway", Action.LOG_POSES),
)

COMMANDS = {spec.name: spec for spec in _SPECS}


TREAT = "treat"
"""Group that a signed peer also needs for steps `by_surgeon`, in whatever command they are."""

GROUPS = {
    "read": ("get_jnt_angsxxxx", "get_eff_posexxxx"),
    "stream": ("start_visualizex", "stop_visualizexx", "tre_startcalcuxx", "tre_stopcalcuxxx"),
    "record": ("save_planandreal", "save_continupose"),
    "plan": (
        "img_fid_numxxxxx", "img_fid_pntxxxxx", "img_fid_lastrecv", "target_rotxxxxxx", "target_tslxxxxxx",
        "session_reinitxx", "grid_numxxxxxxxx", "grid_posexxxxxxx", "grid_lastrecvxxx", "grid_aimxxxxxxxx",
        "grid_skipxxxxxxx", "grid_repeatxxxxx",
    ),
    "digitize": (
        "start_autodigitz", "img_dig_digitize", "img_dig_prevxxxx", "img_dig_prevhilg", "icp_digitizexxxx",
        "icp_pointxxxxxxx", "icp_clear_prevxx", "icp_clear_allxxx",
    ),
    "register": ("start_registrati", "start_useprevreg", "icp_registerxxxx"),
    "robot": ("rob_conn_onxxxxx", "rob_conn_offxxxx", "get_jnt_setinitx"),
    "motion": (
        "execute_motionxx", "execute_confirmx", "execute_backinit", "execute_bkoffset", "execute_homexxxx",
        "end_session_back", "adjust_tranxxxxx", "adjust_oriexxxxx", "locate_armxxxxxx",
    ),
    TREAT: ("grid_performxxxx",),
}  # fmt: skip
"""Groups of commands by name; each command but Stop is in one."""

DEFAULT = ("read", "stream", "record", "plan", "digitize", "register")
"""Groups of a planner. Connecting and moving the robot must be listed: only people beside it should do that."""

STOP = next(name for name, spec in COMMANDS.items() if spec.action is Action.STOP)


def allowed(entries: Iterable[str]) -> frozenset[str]:
    """Return the commands of a list of commands and groups; Stop is always one of them.

    Raises:
        ConfigurationError: An entry is neither a command nor a group.
    """
    found = {STOP}
    for entry in entries:
        if entry in GROUPS:
            found.update(GROUPS[entry])
        elif entry in COMMANDS:
            found.add(entry)
        else:
            raise ConfigurationError(
                f"allow holds {entry!r}, which is neither a command nor one of the groups {', '.join(GROUPS)}.",
                entry=entry,
            )
    return frozenset(found)
