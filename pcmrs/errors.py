"""The error tree: every refusal names what happened, the value, the limit and what to do."""

from __future__ import annotations

from typing import Any, ClassVar

__all__ = [
    "AccessError",
    "AlteredSegmentError",
    "ArchiveError",
    "BackupError",
    "BlueprintError",
    "BusError",
    "CommandRefusedError",
    "ConfigurationError",
    "DegenerateMotionError",
    "DegeneratePointsError",
    "DeviceError",
    "DeviceRefusedError",
    "DoubledSegmentError",
    "FileFormatError",
    "GeometryError",
    "JournalError",
    "MirroredPointsError",
    "MissingSegmentError",
    "MissingTransformError",
    "MotionInterruptedError",
    "PayloadError",
    "PcmrsError",
    "ReentrancyError",
    "RefusalError",
    "ReplayError",
    "SealError",
    "SupervisionError",
    "UnknownOutcomeError",
    "UnreachableError",
]


class PcmrsError(Exception):
    """Base of every error that PCMRS raises on purpose.

    Attributes:
        code: Stable snake_case name that programs may match on.
        text: One or two sentences: what happened, the value, the limit, what to do.
        fields: Values in the text, as data.
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
    """A check or a step refuses a command; the dispatcher turns this into a verdict, never a traceback.

    Args:
        refusal_code: Code of the reason in the verdict, such as ``residual_too_large``.
        text: One or two sentences: what happened, the value, the limit, what to do.
        **fields: Values in the text, as data.
    """

    code = "refused"

    def __init__(self, refusal_code: str, text: str, **fields: Any) -> None:
        super().__init__(text, **fields)
        self.refusal_code = refusal_code


class UnknownOutcomeError(PcmrsError):
    """It is unknown whether the action happened, because the device is silent or gone. Never retried."""

    code = "outcome_unknown"


class DeviceError(PcmrsError):
    """A device answered with a failure."""

    code = "device_failed"


class DeviceRefusedError(DeviceError):
    """A device refused a command; nothing happened."""

    code = "device_refused"


class MotionInterruptedError(DeviceError):
    """A device broke off a motion by itself."""

    code = "motion_interrupted"


class BusError(PcmrsError):
    """The bus cannot be opened or used."""

    code = "bus_unavailable"


class PayloadError(PcmrsError):
    """Bytes on an edge of the system do not have the form that their key or command requires."""

    code = "malformed"


class SealError(PcmrsError):
    """A message between daemon and device nodes has no valid seal.

    The field ``why`` is ``unsealed``, ``forged``, ``repeated`` or ``other_run``.
    """

    code = "not_sealed"


class AccessError(PcmrsError):
    """A user may not take part in this cell, or a message in the name of a user is not proved to be theirs.

    The field ``why`` is ``unknown``, ``revoked``, ``expired`` or ``foreign`` for a user who may not take part, ``role``
    for one who may not command;
    ``unsigned``, ``forged``, ``certificate``, ``old``, ``ahead`` or ``repeated`` for the signature of a message.
    """

    code = "access_denied"


class CommandRefusedError(PcmrsError):
    """The daemon did not accept a command; the field ``verdict`` holds the reason."""

    code = "command_refused"


class FileFormatError(PcmrsError):
    """A file of other software cannot be read, or does not fit its format; the text names file and key."""

    code = "bad_file"


class JournalError(PcmrsError):
    """The journal cannot be written or read; nothing may be acknowledged any more."""

    code = "journal_unavailable"


class BackupError(PcmrsError):
    """A backup of a cell is damaged, of a later version, or would not be whole."""

    code = "backup_unusable"


class ArchiveError(PcmrsError):
    """An archive of journals cannot be opened, read or written."""

    code = "archive_unavailable"


class MissingSegmentError(ArchiveError):
    """Rows that an archive must hold are not there."""

    code = "segment_missing"


class AlteredSegmentError(ArchiveError):
    """Rows of an archive are not those that were archived, or a journal no longer holds what was archived of it."""

    code = "segment_altered"


class DoubledSegmentError(ArchiveError):
    """The same rows would be, or are, in an archive twice."""

    code = "segment_doubled"


class SupervisionError(PcmrsError):
    """A task of the daemon has died too often for the daemon to go on; motion was held before it ended."""

    code = "task_failed"


class ReplayError(PcmrsError):
    """This program cannot replay a journal; the text names the file, the row and what is missing."""

    code = "not_replayable"


class ReentrancyError(PcmrsError):
    """An operation awaited its own dispatcher, which would be a deadlock."""

    code = "reentrant"


class GeometryError(PcmrsError):
    """Numbers are not a pose or a rotation, or are too degenerate to compute with."""

    code = "bad_geometry"


class MissingTransformError(GeometryError):
    """No chain of known transforms connects two frames."""

    code = "missing_transform"


class DegeneratePointsError(GeometryError):
    """Points do not determine a rigid transform: they are too few, coincident or on one line."""

    code = "degenerate_points"


class DegenerateMotionError(GeometryError):
    """Poses do not determine a calibration: they are too few, or rotated about one axis only."""

    code = "degenerate_motion"


class MirroredPointsError(GeometryError):
    """One set of paired points is the mirror image of the other, so no rotation maps them."""

    code = "mirrored"


class UnreachableError(GeometryError):
    """No joint posture within the limits reaches the pose."""

    code = "unreachable"
