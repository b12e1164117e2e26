"""Settings of the page that the daemon serves."""

from __future__ import annotations

from typing import Annotated, Final, Literal

import msgspec

HOST: Final = "127.0.0.1"
TOKEN: Final = "console.token"  # noqa: S105  # the name of a file
"""File in the cell's folder with the token of the page; only its owner may read it."""
UPLOADS: Final = "uploads"
"""Folder in the cell's folder for uploaded files of patients, while they are read."""

MotionConsent = Literal["hold", "confirm"]
"""How a person shows that a motion is meant: by pressing and holding its button, or by confirming it in a dialog."""


class ConsoleSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The page that the daemon serves on its own machine, in a separate process.

    Attributes:
        enabled: Serve it; this needs the extra ``console``.
        port: Port on loopback.
        language: Language of pages that ask for none.
        consent: How a person shows that a motion is meant: press and hold, or confirm in a dialog.
    """

    enabled: bool = True
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)] = 8080
    language: Literal["en", "de"] = "en"
    consent: MotionConsent = "hold"
