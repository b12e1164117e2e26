"""Tool definitions: the SROM files that tell a tracker how the markers of a tool stand to each other."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

from pcmrs.errors import ConfigurationError

SIZE = 752
"""Bytes of a passive tool's definition."""
LARGEST = 1024
"""Bytes that a tracker has room for."""
MAGIC = b"NDI"
"""With which every definition begins."""


def placeholder(body: str) -> bytes:
    """A definition for a virtual tracker that says which body it stands for; no real tracker can use it."""
    return (MAGIC + b"\0PCMRS:" + body.encode("ascii") + b"\0").ljust(SIZE, b"\0")


def read_tools(files: Mapping[str, str], hashes: Mapping[str, str]) -> dict[str, bytes]:
    """Body to the definition of its tool, checked before anything is sent to the tracker.

    Args:
        files: Body to path of its SROM file.
        hashes: Body to the SHA-256 of that file in hexadecimal digits, where it is to be checked.

    Raises:
        ConfigurationError: A file is missing, is no tool definition, or is another one than was agreed.
    """
    strangers = sorted(set(hashes) - set(files))
    if strangers:
        text = f"ndi.sha256 names {', '.join(strangers)}, which ndi.tools does not; correct one of them."
        raise ConfigurationError(text, bodies=strangers)
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
            f"ndi.tools.{body}: {file} is no tool definition: it has {len(content)} bytes or more and begins with "
            f"{content[:3]!r}; one begins with {MAGIC!r} and has {LARGEST} bytes at most."
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
