"""Calibration files: versioned TOML with a hash of the content."""

from __future__ import annotations

import hashlib
import math
import tomllib
from datetime import datetime
from pathlib import Path
from typing import Annotated, Final, Literal, get_args

import msgspec
import tomli_w

from pcmrs.errors import FileFormatError, GeometryError
from pcmrs.formats.reading import check_schema, read_text, refuse
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Transform

Kind = Literal["tool", "tip", "pointer"]
"""Kind of calibration: marker body of a tool on the flange, contact point of a tool in its marker body, or tip of a
pointer."""
KINDS: tuple[Kind, ...] = get_args(Kind)
"""All kinds."""
ToolType = Literal["coil", "drill_guide"]
"""Type of a calibrated tool."""

TRANSFORM: dict[Kind, str] = {
    "tool": "flange_from_tool_marker",
    "tip": "tool_marker_from_tool_tip",
    "pointer": "pointer_from_tip",
}
"""Transform that a calibration of each kind must hold; the frames are those of `pcmrs.spatial.Frame`."""
COMMAND: dict[Kind, str] = {
    "tool": "pcmrs calibrate hand-eye",
    "tip": "pcmrs calibrate tip",
    "pointer": "pcmrs calibrate pivot",
}
"""Command that makes a calibration of each kind."""
MARKER_AS_TOOL = "flange_from_coil"
"""Transform of a tool in earlier files, which did not distinguish its marker body from its contact point."""

SCHEMA: Final = 1
"""Version of the file format."""
HEADER = "# A calibration of PCMRS. The hash covers every value: what is changed by hand is refused; calibrate again.\n"

Label = Annotated[str, msgspec.Meta(max_length=200, pattern=r"\A[^\x00-\x1f\x7f]*\Z")]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Count = Annotated[int, msgspec.Meta(ge=1)]


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One calibration of a tool or pointer.

    Attributes:
        schema: Version of the file format.
        kind: ``tool``, ``tip`` or ``pointer``.
        type: Type of the tool; empty for a pointer.
        name: Name of the tool or pointer.
        serial: Serial number of the tool or pointer; empty if it has none.
        version: Number that grows with every calibration of the same tool or pointer.
        cell: ``site/cell`` in which the calibration was made and may be used; empty for any cell.
        method: Method of the calibration, for people.
        date: Date and time of the calibration.
        valid_days: Number of days for which it may be used.
        error_mm: Root mean square residual of the positions of the calibration poses, mm; of a tip the rms error of its
            contact point, which the predicted error at the target includes.
        error_deg: Root mean square residual of their rotations, deg; of a tip the rms error of its axes; 0 for a
            pointer, which is a point.
        transforms: ``a_from_b`` by name; the one named in `TRANSFORM` is required.
        sha256: Hash of all other values, as stored in the file; empty before the file is written.

    Raises:
        ValueError: A transform is missing or not a pose, a number is not finite, or the type does not fit the kind.
    """

    schema: Literal[1] = 1
    kind: Kind
    type: ToolType | Literal[""] = ""
    name: Annotated[Label, msgspec.Meta(min_length=1)]
    serial: Label = ""
    version: Count = 1
    cell: Label = ""
    method: Label
    date: Annotated[datetime, msgspec.Meta(tz=True)]
    valid_days: Annotated[int, msgspec.Meta(ge=1, le=36500)]
    error_mm: NotNegative
    error_deg: NotNegative = 0.0
    transforms: dict[str, PoseMessage]
    sha256: str = ""

    def __post_init__(self) -> None:
        if (self.kind != "pointer") != bool(self.type):
            raise ValueError(f"a {self.kind} of type {self.type!r}: a tool and its tip have a type, a pointer has none")
        if not (math.isfinite(self.error_mm) and math.isfinite(self.error_deg)):
            raise ValueError("error_mm and error_deg must be finite")
        if TRANSFORM[self.kind] not in self.transforms:
            text = f"a {self.kind} needs transforms.{TRANSFORM[self.kind]}: make it with `{COMMAND[self.kind]}`"
            if MARKER_AS_TOOL in self.transforms:
                text = (
                    f"transforms.{MARKER_AS_TOOL} took the marker body of the tool for its contact point: calibrate "
                    f"both, with `{COMMAND['tool']}` and `{COMMAND['tip']}`"
                )
            raise ValueError(text)
        for name, pose in self.transforms.items():
            try:
                Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)
            except GeometryError as error:
                raise ValueError(f"transforms.{name}: {error.text}") from None

    def transform(self) -> Transform:
        """Return the transform of `TRANSFORM`: for example ``tool_marker_from_tool_tip`` of a tip."""
        pose = self.transforms[TRANSFORM[self.kind]]
        return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)

    def content_hash(self) -> str:
        """Return the SHA-256 of everything but `sha256`: of the values, not of their notation in the file."""
        # Keys are sorted below, so that their order in the file does not matter.
        content = msgspec.structs.replace(self, sha256="")
        return hashlib.sha256(msgspec.json.encode(content, order="sorted")).hexdigest()

    def title(self) -> str:
        """Return name, serial number, version and date for messages."""
        serial = f", serial {self.serial}" if self.serial else ""
        return f"{self.name}{serial} (version {self.version} of {self.date:%Y-%m-%d})"


def read_calibration(path: Path) -> Calibration:
    """Return the calibration in a file as it is. `check_valid` decides whether it may be used.

    Raises:
        FileFormatError: The file cannot be read or is not a calibration; the text says which key is wrong.
    """
    try:
        content = tomllib.loads(read_text(path))
        check_schema(path, content.get("schema", SCHEMA), SCHEMA)
        return msgspec.convert(content, Calibration)
    except (msgspec.ValidationError, RecursionError) as error:
        refuse(path, f"is not a calibration: {error}.")
    except (ValueError, OverflowError) as error:  # more than TOMLDecodeError: a number may have too many digits
        refuse(path, f"is not TOML: {error}.")


def write_calibration(path: Path, calibration: Calibration) -> Calibration:
    """Write a calibration with its hash, completely or not at all.

    Args:
        path: File to write. An existing one is replaced.
        calibration: Calibration to write; its hash is ignored.

    Returns:
        The calibration with its hash, as it was written.

    Raises:
        FileFormatError: The file cannot be written.
    """
    hashed = msgspec.structs.replace(calibration, sha256=calibration.content_hash())
    partial = path.with_name(f".{path.name}.part")
    try:
        partial.write_text(HEADER + tomli_w.dumps(msgspec.to_builtins(hashed, builtin_types=(datetime,))), "utf-8")
        # An atomic replacement: a crash leaves the old file or the new one, never a part.
        partial.replace(path)
    except OSError as error:
        raise FileFormatError(f"{path} cannot be written: {error.strerror}.", file=str(path)) from None
    return hashed


def next_version(path: Path, kind: Kind, name: str, serial: str) -> int:
    """Return the version of a new calibration in a file: 1, or one more than the present one.

    Args:
        path: File that the new calibration will be written to.
        kind: Kind of the new calibration.
        name: Name of the tool or pointer.
        serial: Serial number of the tool or pointer, or an empty string.

    Raises:
        FileFormatError: The file holds the calibration of another tool or pointer, which must not be overwritten.
    """
    if not path.exists():
        return 1
    present = read_calibration(path)
    if (present.kind, present.name, present.serial) != (kind, name, serial):
        refuse(path, f"holds the calibration of another tool or pointer, {present.title()}: choose another file.")
    return present.version + 1
