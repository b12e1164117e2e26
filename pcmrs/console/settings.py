"""How the daemon serves the page."""

from __future__ import annotations

from typing import Annotated, Final, Literal

import msgspec

HOST: Final = "127.0.0.1"
TOKEN: Final = "console.token"  # noqa: S105  # the name of a file
"""File in the cell's folder that has what opens the page; only its owner may read it."""
UPLOADS: Final = "uploads"
"""Folder in the cell's folder, for files of patients as long as they are read."""


class ConsoleSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The page that the daemon serves on its own machine, by a process of its own.

    Attributes:
        enabled: Whether it does; not without the extra ``console``.
        port: Where on loopback.
        language: Of whoever asks for none.
    """

    enabled: bool = True
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)] = 8080
    language: Literal["en", "de"] = "en"
