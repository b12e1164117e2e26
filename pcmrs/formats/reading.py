"""Reading of untrusted files: at most a fixed number of bytes, as text, or refused with a reason."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True, eq=False, slots=True)
class YamlFile:
    """Content of a YAML file, with the lines of its keys.

    Attributes:
        path: The file.
        keys: Its keys with their values.
        root: The same as nodes, which have the lines.
    """

    path: Path
    keys: dict[str, Any]
    root: yaml.Node

    def line(self, at: Sequence[str]) -> int:
        """Return the line of a key, from 1: that of the last key on the way to it that is there.

        Args:
            at: The keys on the way, from the outermost one.
        """
        node, line = self.root, self.root.start_mark.line
        for name in at:
            pairs = node.value if isinstance(node, yaml.MappingNode) else ()
            found = next(((key, value) for key, value in pairs if key.value == name), None)
            if found is None:
                break
            key, node = found
            line = key.start_mark.line
        return line + 1

    def refuse(self, at: Sequence[str], problem: str, **fields: Any) -> NoReturn:
        """Raise `FileFormatError` with a text that begins with file and line.

        Args:
            at: The keys on the way to the key that is wrong, from the outermost one.
            problem: The rest of the text.
            fields: Fields of the error.

        Raises:
            FileFormatError: Always.
        """
        line = self.line(at)
        refuse(self.path, f"in line {line} {problem}", line=line, **fields)


def read_yaml(path: Path) -> YamlFile:
    """Return the content of a YAML file.

    Raises:
        FileFormatError: It is not YAML, has a key twice, or is not a mapping; the text says where.
    """
    loader = None
    try:
        loader = _UntrustedLoader(read_text(path))
        root = loader.get_single_node()
        found = None if root is None else loader.construct_document(root)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # a ValueError for a date that does not exist
        reason = " ".join(str(error).split())
        refuse(path, f"is not YAML: {reason}.")
    finally:
        if loader is not None:
            loader.dispose()
    if root is None or not isinstance(found, dict):
        refuse(path, "holds no keys with values (KEY: ...): it is empty, or another kind of file.")
    return YamlFile(path, found, root)


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
    """Loader that refuses huge integers, and keys that occur twice: the library would silently take the last one."""

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
