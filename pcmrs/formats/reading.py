"""Reading of untrusted files: at most a fixed number of bytes, as text, or refused with a reason."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any, NoReturn

import yaml

from pcmrs.errors import FileFormatError

MAX_TEXT_BYTES = 1024 * 1024
"""Limit of a file of points or poses: a hundred times the largest useful one."""

MOST_INTEGER = 2**63
"""Limit of an integer in a YAML file."""


def refuse(path: Path, problem: str, **fields: Any) -> NoReturn:
    """Raise `FileFormatError` with a text that begins with the file.

    Args:
        path: The file.
        problem: The rest of the text.
        fields: Fields of the error.

    Raises:
        FileFormatError: Always.
    """
    raise FileFormatError(f"{path} {problem}", file=str(path), **fields) from None


def check_schema(path: Path, found: object, newest: int) -> None:
    """Refuse a file whose format is of a later version of PCMRS.

    Args:
        path: The file.
        found: Version of its format, as the file has it.
        newest: Latest version that this program reads.

    Raises:
        FileFormatError: The version is not a number from 1 to `newest`.
    """
    if not isinstance(found, int) or not 1 <= found <= newest:
        refuse(
            path,
            f"has format {found!r}, and this version of PCMRS reads 1 to {newest}: use the version that wrote it, or a "
            "later one.",
            format=found,
            limit=newest,
        )


def read_bytes(path: Path, limit: int) -> bytes:
    """Return the bytes of a file.

    Args:
        path: The file.
        limit: Largest number of bytes.

    Raises:
        FileFormatError: It cannot be read, or is longer than `limit` bytes.
    """
    try:
        with path.open("rb") as stream:
            raw = stream.read(limit + 1)
    except (OSError, ValueError) as error:  # a ValueError for a text that cannot be a path
        reason = error.strerror if isinstance(error, OSError) else str(error)
        refuse(path, f"cannot be read: {reason}.")
    if len(raw) > limit:
        refuse(path, f"is longer than {limit} bytes, the limit of such a file.", limit=limit)
    return raw


def read_text(path: Path) -> str:
    """Return the text of a file without a byte order mark.

    Raises:
        FileFormatError: It cannot be read, is too long or is not UTF-8.
    """
    try:
        return read_bytes(path, MAX_TEXT_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        refuse(path, f"is not UTF-8 text: byte {error.start} is 0x{error.object[error.start]:02x}; save it as UTF-8.")


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the keys of a YAML file.

    Raises:
        FileFormatError: It is not YAML, has a key twice, or is not a mapping; the text says where.
    """
    try:
        found = yaml.load(read_text(path), Loader=_UntrustedLoader)  # noqa: S506  # it is a SafeLoader
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # a ValueError for a date that does not exist
        reason = " ".join(str(error).split())
        refuse(path, f"is not YAML: {reason}.")
    if not isinstance(found, dict):
        refuse(path, "holds no keys with values (KEY: ...): it is empty, or another kind of file.")
    return found


def read_table(path: Path) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """Return the rows of a CSV file with a header, without blank lines.

    Returns:
        The columns in lower case, and for each row its line and the cells by column; both empty for an empty file.

    Raises:
        FileFormatError: It is not CSV, has a column twice, or a row has more cells than the header.
    """
    try:
        reader = csv.reader(read_text(path).splitlines())
        lines = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader if any(map(str.strip, cells))]
    except csv.Error as error:
        refuse(path, f"is not CSV: {error}.")
    columns = [cell.lower() for cell in lines[0][1]] if lines else []
    if len(columns) == 1 and ";" in columns[0]:
        refuse(path, "has semicolons between its columns; save it with commas there, and points in numbers.")
    twice = next((name for index, name in enumerate(columns) if name and name in columns[:index]), None)
    if twice is not None:
        refuse(path, f"has the column {twice} twice; leave one.", column=twice)
    for line, cells in lines[1:]:
        if any(cells[len(columns) :]):
            refuse(path, f"has more values than columns in row {line}; write numbers as 0.5, not as 0,5.", row=line)
    return columns, [(line, dict(zip(columns, cells, strict=False))) for line, cells in lines[1:]]


class _UntrustedLoader(yaml.SafeLoader):
    """Refuses huge integers, and keys that occur twice: the library would silently take the last one."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        twice = next((key for index, key in enumerate(keys) if key in keys[:index]), None)
        if twice is not None:
            raise yaml.constructor.ConstructorError(None, None, f"the key {twice} is given twice", node.start_mark)
        return super().construct_mapping(node, deep)

    def construct_integer(self, node: yaml.ScalarNode) -> int:
        """Return an integer, and refuse one that Python could not print: hexadecimal ones may have any length."""
        value: int = super().construct_yaml_int(node)
        if not -MOST_INTEGER < value < MOST_INTEGER:
            raise yaml.constructor.ConstructorError(None, None, "an integer has more than 64 bits", node.start_mark)
        return value


_UntrustedLoader.add_constructor("tag:yaml.org,2002:int", _UntrustedLoader.construct_integer)
