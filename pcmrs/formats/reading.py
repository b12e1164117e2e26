"""Files that anybody may have written: never more of them than a limit, and as text, or refused with a reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

import yaml

from pcmrs.errors import FileFormatError

MAX_TEXT_BYTES = 1024 * 1024
"""Of a file of points or poses: a hundred times the largest that makes sense."""


def refuse(path: Path, problem: str, **fields: Any) -> NoReturn:
    """Raises `FileFormatError` with a text that begins with the file."""
    raise FileFormatError(f"{path} {problem}", file=str(path), **fields) from None


def read_bytes(path: Path, limit: int) -> bytes:
    """The bytes of a file.

    Raises:
        FileFormatError: It cannot be read, or is longer than `limit` bytes.
    """
    try:
        with path.open("rb") as stream:
            raw = stream.read(limit + 1)
    except (OSError, ValueError) as error:  # a ValueError where it cannot be a path
        reason = error.strerror if isinstance(error, OSError) else str(error)
        refuse(path, f"cannot be read: {reason}.")
    if len(raw) > limit:
        refuse(path, f"is longer than {limit} bytes, more than is read of such a file.", limit=limit)
    return raw


def read_text(path: Path) -> str:
    """The text of a file without a byte order mark. Raises `FileFormatError`."""
    try:
        return read_bytes(path, MAX_TEXT_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        refuse(path, f"is not UTF-8 text: byte {error.start} is 0x{error.object[error.start]:02x}.")


def read_yaml(path: Path) -> dict[str, Any]:
    """The keys of a YAML file.

    Raises:
        FileFormatError: It is no YAML, holds a key twice, or is no mapping; the text says where.
    """
    try:
        found = yaml.load(read_text(path), Loader=_UniqueKeysLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # a ValueError for a date that does not exist
        reason = " ".join(str(error).split())
        refuse(path, f"is not YAML: {reason}.")
    if not isinstance(found, dict):
        refuse(path, f"holds no keys but {type(found).__name__}.")
    return found


class _UniqueKeysLoader(yaml.SafeLoader):
    """Refuses what YAML forbids and the library lets pass: of a landmark given twice it would take the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        twice = next((key for index, key in enumerate(keys) if key in keys[:index]), None)
        if twice is not None:
            raise yaml.constructor.ConstructorError(None, None, f"the key {twice} is given twice", node.start_mark)
        return super().construct_mapping(node, deep)
