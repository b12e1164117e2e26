"""The error tree: every refusal says what, which value, which limit and what to do."""

from __future__ import annotations

from typing import Any, ClassVar


class PcmrsError(Exception):
    """Base of every error that PCMRS raises on purpose.

    Attributes:
        code: Stable snake_case name that programs may match on.
        text: One readable sentence or two: what, which value, which limit, what to do.
        fields: The values named in the text, as data.
    """

    code: ClassVar[str] = "error"

    def __init__(self, text: str, **fields: Any) -> None:
        super().__init__(text)
        self.text = text
        self.fields = fields


class ConfigurationError(PcmrsError):
    """A configuration value is missing, unknown or out of range."""

    code = "bad_configuration"


class BlueprintError(PcmrsError):
    """A workflow blueprint cannot be read or breaks a rule."""

    code = "unsound_blueprint"


class RefusalError(PcmrsError):
    """A check or a step says no; the dispatcher turns it into a verdict, never a traceback.

    Args:
        refusal_code: The reason's code in the verdict, such as ``residual_too_large``.
        text: What, which value, which limit, what to do.
        **fields: The values named in the text.
    """

    code = "refused"

    def __init__(self, refusal_code: str, text: str, **fields: Any) -> None:
        super().__init__(text, **fields)
        self.refusal_code = refusal_code


class UnknownOutcomeError(PcmrsError):
    """Nobody can say whether the action happened: the device is silent or gone. Never retried."""

    code = "outcome_unknown"


class DeviceError(PcmrsError):
    """A device answered with a failure."""

    code = "device_failed"


class DeviceRefusedError(DeviceError):
    """A device answered that it does not do what it was told; nothing happened."""

    code = "device_refused"


class MotionInterruptedError(DeviceError):
    """A device broke off a motion by itself."""

    code = "motion_interrupted"


class BusError(PcmrsError):
    """The bus cannot be opened or used."""

    code = "bus_unavailable"


class PayloadError(PcmrsError):
    """Bytes on an edge of the system do not hold what their key or command promises."""

    code = "malformed"


class SealError(PcmrsError):
    """A message between daemon and device nodes was not sealed by one of them; the field ``why`` says what is wrong."""

    code = "not_sealed"


class AccessError(PcmrsError):
    """Somebody may not take part in this cell, or a message in their name is not theirs, by all that can be seen.

    The field ``why`` is ``unknown``, ``revoked``, ``expired`` or ``foreign`` for who may not take part; ``unsigned``,
    ``forged``, ``certificate``, ``old``, ``ahead`` or ``repeated`` for the signature of a message.
    """

    code = "access_denied"


class CommandRefusedError(PcmrsError):
    """The daemon did not accept a planner's command; the field ``verdict`` says why."""

    code = "command_refused"


class FileFormatError(PcmrsError):
    """A file of other software cannot be read, or does not hold what its kind promises; file and key are named."""

    code = "bad_file"


class JournalError(PcmrsError):
    """The journal cannot be written or read; nothing may be acknowledged any more."""

    code = "journal_unavailable"


class SupervisionError(PcmrsError):
    """A task of the daemon has died too often for the daemon to go on; motion was held before it ended."""

    code = "task_failed"


class ReplayError(PcmrsError):
    """A journal cannot be replayed by this program; file, row and what is missing are named."""

    code = "not_replayable"


class ReentrancyError(PcmrsError):
    """An operation awaited its own dispatcher, which would wait for itself for ever."""

    code = "reentrant"


class GeometryError(PcmrsError):
    """Numbers that are no pose, no rotation, or too degenerate to compute with."""

    code = "bad_geometry"


class MissingTransformError(GeometryError):
    """No chain of known transforms joins two frames."""

    code = "missing_transform"


class DegeneratePointsError(GeometryError):
    """Points that do not fix a rigid transform: too few, coincident or on one line."""

    code = "degenerate_points"


class DegenerateMotionError(GeometryError):
    """Poses that do not fix a calibration: too few, or turned about one axis only."""

    code = "degenerate_motion"


class MirroredPointsError(GeometryError):
    """Paired points of which one set is the mirror image of the other: no rotation maps them."""

    code = "mirrored"


class UnreachableError(GeometryError):
    """No joint posture within the limits reaches the pose."""

    code = "unreachable"
