"""The robotic TMS workflow stated a second time, naively, from the tables of the specification.

It knows nothing of blueprints, cascades or closures: for a joint state and an operation it says outright
where each ending leads. `None` means rejected.
"""

from __future__ import annotations

from pathlib import Path

import pcmrs

BLUEPRINT = Path(pcmrs.__file__).parent / "workflows" / "ratms.toml"

Joint = tuple[str, str, str, str, str]
"""registration, digitization, toolplan, robot, placement"""

Endings = dict[str, Joint]
"""Name of an ending (a declared outcome, ``failed`` or ``unknown``) to the joint state it commits."""

BRANCHES = ("registration", "digitization", "toolplan", "robot", "placement")
INITIAL: Joint = ("000", "0", "0", "0", "unknown")

USER_OPERATIONS = {
    "registration": [
        "plan_landmarks",
        "register",
        "use_previous",
        "clear_landmarks",
        "reinit",
        "clear_digitization",
        "clear_registration",
    ],
    "digitization": [
        "digitize_all",
        "digitize_one",
        "redigitize_one",
        "reuse_previous",
        "reuse_previous_except",
        "reinit",
    ],
    "toolplan": ["plan", "clear", "reinit"],
    "robot": ["connect", "disconnect", "acknowledge"],
    "placement": ["locate", "approach", "confirm", "nudge", "back_off", "home", "to_initial", "reinit"],
}
EVENT_OPERATIONS = {"robot": ["link_lost"]}
INTERNAL_OPERATIONS = {"registration": ["digitized", "undigitized"], "robot": ["placement_changed"]}
MOTIONS = ["approach", "confirm", "nudge", "back_off", "home", "to_initial"]


def expected(joint: Joint, branch: str, operation: str) -> Endings | None:
    """What the specification says: where each ending leads, or None for a rejection."""
    answer: Endings | None = {
        "registration": _registration,
        "digitization": _digitization,
        "toolplan": _toolplan,
        "robot": _robot,
        "placement": _placement,
    }[branch](joint, operation)
    if answer is None:
        return None
    return {"failed": joint, "unknown": joint} | answer


def reachable() -> list[Joint]:
    """Every joint state that commands can lead to."""
    found, waiting = [INITIAL], [INITIAL]
    while waiting:
        joint = waiting.pop()
        for branch, operation in all_operations():
            for after in (expected(joint, branch, operation) or {}).values():
                if after not in found:
                    found.append(after)
                    waiting.append(after)
    return found


def all_operations() -> list[tuple[str, str]]:
    """Everything that users and devices may ask for."""
    return [(b, o) for table in (USER_OPERATIONS, EVENT_OPERATIONS) for b, names in table.items() for o in names]


def as_dict(joint: Joint) -> dict[str, str]:
    return dict(zip(BRANCHES, joint, strict=True))


def _with_registration(joint: Joint, registration: str) -> Joint:
    """Digitization is 1 exactly where the registration's second digit is; a tool at the head is revoked."""
    return (registration, registration[1], joint[2], joint[3], _revoked(joint[4]))


def _revoked(placement: str) -> str:
    return "held" if placement in ("standoff", "placed") else placement


def _away(joint: Joint) -> bool:
    return joint[4] in ("retracted", "unknown")


def _registration(joint: Joint, operation: str) -> Endings | None:
    here = joint[0]
    target = {
        "plan_landmarks": "100",
        "register": "111" if here in ("110", "111") else None,
        "use_previous": "111",
        "clear_landmarks": "000",
        "reinit": "000" if _away(joint) else None,
        "clear_digitization": "100" if here in ("110", "111") else None,
        "clear_registration": "110" if here == "111" else None,
    }[operation]
    return None if target is None else {"done": _with_registration(joint, target)}


def _digitization(joint: Joint, operation: str) -> Endings | None:
    registration, digitized = joint[0], joint[1] == "1"
    if operation in ("digitize_all", "reuse_previous", "reuse_previous_except"):
        return None if registration == "000" else {"done": _with_registration(joint, "110")}
    if operation == "digitize_one":
        return {"partial": joint, "complete": _with_registration(joint, "110")} if registration == "100" else None
    if operation == "redigitize_one":
        return {"done": _with_registration(joint, "100")} if digitized else None
    return {"done": _with_registration(joint, "100") if digitized else joint}


def _toolplan(joint: Joint, operation: str) -> Endings | None:
    if operation == "reinit" and not _away(joint):
        return None
    return {"done": (joint[0], joint[1], "1" if operation == "plan" else "0", joint[3], _revoked(joint[4]))}


def _robot(joint: Joint, operation: str) -> Endings | None:
    connected = joint[3] == "1"
    if operation == "connect":
        return None if connected else {"done": (*joint[:3], "1", "unknown")}
    if not connected or (operation == "disconnect" and not _away(joint)):
        return None
    return {"done": joint if operation == "acknowledge" else (*joint[:3], "0", "unknown")}


def _placement(joint: Joint, operation: str) -> Endings | None:
    here, connected = joint[4], joint[3] == "1"
    ready = joint[0] == "111" and joint[2] == "1" and connected

    def at(placement: str) -> Joint:
        return (*joint[:4], placement)

    if operation == "reinit":
        return {"done": at("unknown")} if _away(joint) else None
    if operation == "locate":
        return {"retracted": at("retracted"), "held": at("held")} if here == "unknown" and connected else None
    motion: Endings | None = None
    if operation == "approach" and here == "retracted" and ready:
        motion = {"done": at("standoff")}
    if operation == "confirm" and here == "standoff" and ready:
        motion = {"done": at("placed")}
    if operation == "nudge" and here in ("standoff", "placed") and ready:
        motion = {"done": joint}
    if operation == "back_off" and here in ("standoff", "placed", "held") and connected:
        # Without a valid plan and registration there is no standoff to be at: the arm is clear of the body or not.
        motion = {"retracted": at("retracted"), "held": at("held")} | ({"standoff": at("standoff")} if ready else {})
    if operation in ("home", "to_initial") and here in ("retracted", "standoff", "placed") and connected:
        motion = {"done": at("retracted")}
    return None if motion is None else motion | {"failed": at("held"), "unknown": at("unknown")}
