"""The typed messages that cross the bus or the journal.

SI units; quaternions are ``quat_wxyz``. Time stamps are seconds of the sender's monotonic clock, so an age is
(sent - captured) at the sender plus (now - received) at the receiver.
"""

from pcmrs.messages._base import Message
from pcmrs.messages._decisions import (
    Command,
    Decision,
    DryRunRequest,
    DryRunResult,
    JournalPage,
    JournalQuery,
    NextStep,
    NextStepRequest,
    Reason,
    StageShown,
    Verdict,
)
from pcmrs.messages._poses import Beeps, BodyPose, LandmarkPrompt, PoseMessage, Target
from pcmrs.messages._robot import (
    JointSetpoint,
    JointState,
    JointTrajectory,
    MotionOutcome,
    MotionResult,
    PressRequest,
    ServoSession,
)
from pcmrs.messages._scene import HeadBurst, HeadMotion, HeadStep, SceneTruth
from pcmrs.messages._snapshot import (
    STOP_NOT_NAMED,
    ActiveActivity,
    BlueprintTag,
    Flags,
    LeaseState,
    Running,
    Snapshot,
    StopState,
    TouchPrompt,
    UnknownOutcome,
)
from pcmrs.messages._stimulation import Epoch, FiredPulse, StimulatorState
from pcmrs.messages.device import (
    ActToken,
    Beat,
    DeviceEvent,
    DeviceHealth,
    DeviceReply,
    DeviceRequest,
    GateState,
    NodeBeat,
)
from pcmrs.messages.scene_event import SceneEvent
from pcmrs.messages.teleop import TeleopSetpoint, TeleopStatus

__all__ = [
    "STOP_NOT_NAMED",
    "ActToken",
    "ActiveActivity",
    "Beat",
    "Beeps",
    "BlueprintTag",
    "BodyPose",
    "Command",
    "Decision",
    "DeviceEvent",
    "DeviceHealth",
    "DeviceReply",
    "DeviceRequest",
    "DryRunRequest",
    "DryRunResult",
    "Epoch",
    "FiredPulse",
    "Flags",
    "GateState",
    "HeadBurst",
    "HeadMotion",
    "HeadStep",
    "JointSetpoint",
    "JointState",
    "JointTrajectory",
    "JournalPage",
    "JournalQuery",
    "LandmarkPrompt",
    "LeaseState",
    "Message",
    "MotionOutcome",
    "MotionResult",
    "NextStep",
    "NextStepRequest",
    "NodeBeat",
    "PoseMessage",
    "PressRequest",
    "Reason",
    "Running",
    "SceneEvent",
    "SceneTruth",
    "ServoSession",
    "Snapshot",
    "StageShown",
    "StimulatorState",
    "StopState",
    "Target",
    "TeleopSetpoint",
    "TeleopStatus",
    "TouchPrompt",
    "UnknownOutcome",
    "Verdict",
]
