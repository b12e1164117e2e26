"""The robotic TMS workflow stated a second time, naively, from the tables of the specification.

It knows nothing of blueprints, cascades or closures: for a joint state and an operation it says outright
where each ending leads. `None` means rejected.
"""

from __future__ import annotations

from pathlib import Path

import pcmrs

BLUEPRINT = Path(pcmrs.__file__).parent / "workflows" / "ratms.toml"

Joint = tuple[str, str, str, str, str, str, str]
"""registration, digitization, toolplan, robot, placement, alignment, teleoperation"""

Endings = dict[str, Joint]
"""Name of an ending (a declared outcome, ``failed`` or ``unknown``) to the joint state it commits."""

BRANCHES = ("registration", "digitization", "toolplan", "robot", "placement", "alignment", "teleoperation")
INITIAL: Joint = ("000", "0", "0", "0", "unknown", "0", "off")

USER_OPERATIONS = {
    "registration": [
        "plan_landmarks",
        "register",
        "refine",
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
        "reuse_previous_of",
        "reuse_previous_except",
        "check_landmark",
        "digitize_surface",
        "clear_surface_point",
        "clear_surface",
        "reinit",
    ],
    "toolplan": ["plan", "use_previous", "clear", "reinit"],
    "robot": ["connect", "disconnect", "acknowledge"],
    "placement": [
        "locate",
        "approach",
        "confirm",
        "nudge",
        "press",
        "follow",
        "stop_following",
        "guide",
        "stop_guiding",
        "back_off",
        "home",
        "to_initial",
        "reinit",
    ],
    "alignment": ["reinit"],
    "teleoperation": ["engage", "release", "reinit"],
}
EVENT_OPERATIONS = {
    "registration": ["reference_moved"],
    "robot": ["link_lost"],
    "placement": ["following_lost", "guiding_lost", "watching_lost", "force_limit", "moved_unasked"],
    "alignment": ["within", "outside"],
}
INTERNAL_OPERATIONS = {
    "registration": ["digitized", "undigitized"],
    "robot": ["placement_changed"],
    "placement": ["teleoperation_changed", "alignment_changed"],
}
MOTIONS = ["approach", "confirm", "nudge", "press", "follow", "guide", "back_off", "home", "to_initial"]
AT_BODY = ("standoff", "placed", "following", "guided", "replanned")


def expected(joint: Joint, branch: str, operation: str) -> Endings | None:
    """What the specification says: where each ending leads, or None for a rejection."""
    answer: Endings | None = {
        "registration": _registration,
        "digitization": _digitization,
        "toolplan": _toolplan,
        "robot": _robot,
        "placement": _placement,
        "alignment": _alignment,
        "teleoperation": _teleoperation,
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
    return _revoked((registration, registration[1], *joint[2:]))


def _revoked(joint: Joint) -> Joint:
    """A tool at the body is let go, aligned with nothing and guided by nobody any more."""
    return (*joint[:4], "held", "0", "off") if joint[4] in AT_BODY else joint


def _away(joint: Joint) -> bool:
    return joint[4] in ("retracted", "unknown")


def _registration(joint: Joint, operation: str) -> Endings | None:
    here = joint[0]
    target = {
        "plan_landmarks": "100",
        "register": "111" if here in ("110", "111") else None,
        "refine": "111" if here in ("110", "111") else None,
        "reference_moved": "100" if here in ("110", "111") else None,
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
    if operation in ("digitize_one", "reuse_previous_of"):
        return {"partial": joint, "complete": _with_registration(joint, "110")} if registration == "100" else None
    if operation == "redigitize_one":
        return {"done": _with_registration(joint, "100")} if digitized else None
    if operation in ("check_landmark", "digitize_surface"):
        # A person's hand is at the body: not while the tool is there, unless it has been stopped.
        if not digitized or joint[4] not in ("unknown", "retracted", "held"):
            return None
        moved = {"moved": _with_registration(joint, "100"), "same": joint}
        return moved if operation == "check_landmark" else {"done": joint}
    if operation in ("clear_surface_point", "clear_surface"):
        return {"done": joint} if digitized else None
    return {"done": _with_registration(joint, "100") if digitized else joint}


def _toolplan(joint: Joint, operation: str) -> Endings | None:
    if operation == "reinit" and not _away(joint):
        return None
    if operation in ("clear", "reinit"):
        return {"done": _revoked((*joint[:2], "0", *joint[3:]))}
    planned = (*joint[:2], "1", *joint[3:])
    # Where the tool is at the body, its position may stay known.
    kept = (*planned[:4], "replanned", "0", "off") if joint[4] in AT_BODY else planned
    return {"planned": _revoked(planned), "replanned": kept}


def _robot(joint: Joint, operation: str) -> Endings | None:
    connected = joint[3] == "1"
    if operation == "connect":
        return None if connected else {"done": (*joint[:3], "1", "unknown", "0", "off")}
    if not connected or (operation == "disconnect" and not _away(joint)):
        return None
    return {"done": joint if operation == "acknowledge" else (*joint[:3], "0", "unknown", "0", "off")}


def _placement(joint: Joint, operation: str) -> Endings | None:
    here, connected = joint[4], joint[3] == "1"
    ready = joint[0] == "111" and joint[2] == "1" and connected

    def at(placement: str) -> Joint:
        return (*joint[:4], placement, "0", "off")

    if operation == "reinit":
        return {"done": at("unknown")} if _away(joint) else None
    if operation == "locate":
        return {"retracted": at("retracted"), "held": at("held")} if here == "unknown" and connected else None
    if operation == "force_limit":
        return {"done": at("held")} if here in AT_BODY else None
    if operation == "moved_unasked":
        return {"done": at("held")} if here in (*AT_BODY, "retracted") else None
    if operation in ("following_lost", "watching_lost", "guiding_lost", "stop_guiding"):
        left = {"following_lost": "following", "watching_lost": "placed"}.get(operation, "guided")
        return {"done": at("held")} if here == left else None
    if operation == "stop_following":
        return {"done": at("placed")} if here == "following" else None
    motion: Endings | None = None
    if operation == "approach" and here in ("retracted", "standoff", "replanned") and ready:
        motion = {"done": at("standoff")}
    if operation == "confirm" and here == "standoff" and ready:
        motion = {"done": at("placed")}
    if operation == "confirm" and here == "placed" and ready:
        motion = {"done": joint}
    if operation == "nudge" and here in ("standoff", "placed") and ready:
        motion = {"done": joint}
    if operation == "press" and here == "placed" and ready:
        motion = {"done": joint}
    if operation == "follow" and here == "placed" and ready:
        motion = {"done": at("following")}
    if operation == "guide" and here in ("standoff", "placed") and ready:
        motion = {"done": at("guided")}
    if operation == "back_off" and here in (*AT_BODY, "held") and connected:
        # Without a valid plan and registration there is no standoff to be at: the arm is clear of the body or not.
        motion = {"retracted": at("retracted"), "held": at("held")} | ({"standoff": at("standoff")} if ready else {})
    if operation in ("home", "to_initial") and here in ("retracted", *AT_BODY) and connected:
        motion = {"done": at("retracted")}
    return None if motion is None else motion | {"failed": at("held"), "unknown": at("unknown")}


def _alignment(joint: Joint, operation: str) -> Endings | None:
    if operation == "within" and not (joint[4] in ("placed", "following") and joint[5] == "0"):
        return None
    if operation == "outside" and joint[5] == "0":
        return None
    return {"done": (*joint[:5], "1" if operation == "within" else "0", joint[6])}


def _teleoperation(joint: Joint, operation: str) -> Endings | None:
    if operation == "engage" and not (joint[4] == "guided" and joint[6] == "off"):
        return None
    if operation == "release" and joint[6] == "off":
        return None
    return {"done": (*joint[:6], "engaged" if operation == "engage" else "off")}
