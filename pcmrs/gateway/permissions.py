"""What a signed peer may be allowed: commands, or groups of them.

Stop is in no group: every peer may stop.
"""

from __future__ import annotations

from collections.abc import Iterable

from pcmrs.errors import ConfigurationError
from pcmrs.gateway.commands import COMMANDS, Action

GROUPS = {
    "read": ("get_jnt_angsxxxx", "get_eff_posexxxx"),
    "stream": ("start_visualizex", "stop_visualizexx", "tre_startcalcuxx", "tre_stopcalcuxxx"),
    "record": ("save_planandreal", "save_continupose"),
    "plan": (
        "img_fid_numxxxxx", "img_fid_pntxxxxx", "img_fid_lastrecv", "target_rotxxxxxx", "target_tslxxxxxx",
        "session_reinitxx",
    ),
    "digitize": (
        "start_autodigitz", "img_dig_digitize", "img_dig_prevxxxx", "img_dig_prevhilg", "icp_digitizexxxx",
        "icp_clear_prevxx", "icp_clear_allxxx",
    ),
    "register": ("start_registrati", "start_useprevreg", "icp_registerxxxx"),
    "robot": ("rob_conn_onxxxxx", "rob_conn_offxxxx", "get_jnt_setinitx"),
    "motion": (
        "execute_motionxx", "execute_confirmx", "execute_backinit", "execute_bkoffset", "execute_homexxxx",
        "end_session_back", "adjust_tranxxxxx", "adjust_oriexxxxx",
    ),
}  # fmt: skip
"""Groups of commands by name; each command but Stop is in one."""

DEFAULT = ("read", "stream", "record", "plan", "digitize", "register")
"""What a planner does. Connecting and moving the robot is for whoever stands beside it, and has to be listed."""

STOP = next(name for name, spec in COMMANDS.items() if spec.action is Action.STOP)


def allowed(entries: Iterable[str]) -> frozenset[str]:
    """The commands that a list of commands and groups means; Stop is always one of them.

    Raises:
        ConfigurationError: An entry is neither.
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
