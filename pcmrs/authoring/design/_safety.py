"""The branches that a table need not name: the connection of the robot, and the release of the latch of Stop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pcmrs.fsm.blueprint import BranchSpec, OperationSpec, Requirement, RevocationSpec
from pcmrs.messages.identity import Role

ROBOT, SAFETY = "robot", "safety"
"""Names of the branches."""

CONNECTED, DISCONNECTED = "1", "0"
UNCONNECTED, NEAR = "robot_disconnected", "tool_near_patient"
"""Codes of rejections: the robot is not connected; it is, and something may be at the patient."""

CONNECTING: Sequence[Role] = ("operator", "teleoperator")


def robot_branch(safe: Requirement) -> BranchSpec:
    """Return the branch for the connection of the robot.

    Args:
        safe: States in which nothing that the robot moved is at the patient: only there it may be disconnected.
    """
    roles = list(CONNECTING)
    disconnect = OperationSpec(
        from_=[CONNECTED],
        to=DISCONNECTED,
        roles=roles,
        steps=["disconnect_robot"],
        timeout_s=60,
        requires=safe,
        refusal=dict.fromkeys(safe, NEAR),
    )
    return BranchSpec(
        title="Connection of the robot",
        states={DISCONNECTED: "not connected", CONNECTED: "connected"},
        flags=["robot_connected"],
        operations={
            "connect": OperationSpec(
                from_=[DISCONNECTED], to=CONNECTED, roles=roles, steps=["connect_robot"], timeout_s=60
            ),
            "disconnect": disconnect,
            "link_lost": OperationSpec(from_=[CONNECTED], to=DISCONNECTED, event=True),
        },
    )


def safety_branch() -> BranchSpec:
    """Return the branch for the release of Stop's latch, possible everywhere."""
    acknowledge = OperationSpec(title="Release Stop", from_=["*"], to="watched", roles=["operator"], unlatches=True)
    return BranchSpec(title="Stop", states={"watched": "Stop is heeded"}, operations={"acknowledge": acknowledge})


def lost(ends: Mapping[str, str]) -> list[RevocationSpec]:
    """Return the revocation of a branch when the robot is lost: if a tool was at the patient, that is then unknown.

    Args:
        ends: State to its target state.
    """
    targets = dict.fromkeys(ends.values())
    return [
        RevocationSpec(by=[ROBOT], from_=[state for state, end in ends.items() if end == target], to=target)
        for target in targets
    ]
