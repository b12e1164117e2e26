"""Tool definitions: SROM files with the positions of a tool's markers relative to each other."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

from pcmrs.errors import ConfigurationError

SIZE = 752
"""Length of a passive tool's definition, bytes."""
LARGEST = 1024
"""Longest definition that a tracker can store, bytes."""
MAGIC = b"NDI"
"""First bytes of every definition."""


def placeholder(body: str) -> bytes:
    """Return a definition for a virtual tracker, which contains the name of the body; no real tracker can use it."""
    return (MAGIC + b"\0PCMRS:" + body.encode("ascii") + b"\0").ljust(SIZE, b"\0")


def read_tools(files: Mapping[str, str], hashes: Mapping[str, str]) -> dict[str, bytes]:
    """Read and check the tool definitions, and return them by body.

    Args:
        files: Path of the SROM file by body.
        hashes: SHA-256 of that file in hexadecimal digits by body; bodies without one are not checked.

    Raises:
        ConfigurationError: A file is missing, is not a tool definition, or has another hash.
    """
    unknown = sorted(set(hashes) - set(files))
    if unknown:
        text = f"ndi.sha256 names {', '.join(unknown)}, which ndi.tools does not; correct one of them."
        raise ConfigurationError(text, bodies=unknown)
    return {body: _read_tool(body, Path(file).expanduser(), hashes.get(body, "")) for body, file in files.items()}


def _read_tool(body: str, file: Path, expected: str) -> bytes:
    try:
        with file.open("rb") as opened:
            content = opened.read(LARGEST + 1)
    except OSError as error:
        text = f"ndi.tools.{body}: the tool definition {file} cannot be read: {error.strerror}."
        raise ConfigurationError(text, body=body, file=str(file)) from None
    if not content.startswith(MAGIC) or len(content) > LARGEST:
        text = (
            f"ndi.tools.{body}: {file} is not a tool definition: it has {len(content)} bytes or more and begins with "
            f"{content[:3]!r}; a definition begins with {MAGIC!r} and has {LARGEST} bytes at most."
        )
        raise ConfigurationError(text, body=body, file=str(file), size=len(content))
    found = hashlib.sha256(content).hexdigest()
    if expected and found != expected.lower():
        text = (
            f"ndi.tools.{body}: {file} is not the agreed tool definition: its SHA-256 is {found}, ndi.sha256.{body} "
            f"is {expected}. Check which tool is mounted."
        )
        raise ConfigurationError(text, body=body, file=str(file), found=found, expected=expected)
    return content
