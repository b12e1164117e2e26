"""Key files of signed peers: 32 random bytes as hex, that nobody but their owner may read."""

from __future__ import annotations

import os
import re
import secrets
from pathlib import Path

from pcmrs.errors import ConfigurationError
from pcmrs.files import SECRET, read_secret
from pcmrs.gateway.signing import KEY_BYTES

_HEX = re.compile(r"[0-9a-fA-F]{64}\n?")


def new_key(path: Path) -> None:
    """Writes a new random key; a file that is there stays as it is.

    Raises:
        ConfigurationError: The file exists.
        OSError: It cannot be written.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, SECRET)
    except FileExistsError:
        raise ConfigurationError(
            f"{path} exists, and whoever has this key would be locked out. Remove it first, or take another name.",
            file=str(path),
        ) from None
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(secrets.token_bytes(KEY_BYTES).hex() + "\n")
        file.flush()
        os.fsync(descriptor)


def read_key(path: Path) -> bytes:
    """Reads a key.

    Raises:
        ConfigurationError: The file cannot be read, others than its owner may use it, or it holds no key.
    """
    try:
        content = read_secret(path)
    except OSError as error:
        text = f"The key {path} cannot be read ({error.strerror}); make one with: pcmrs peers new NAME."
        raise ConfigurationError(text, file=str(path)) from None
    text = content.decode("ascii", "replace")
    if not _HEX.fullmatch(text):
        # What the file holds is told to nobody: it may be most of a key.
        raise ConfigurationError(
            f"{path} holds no key: {2 * KEY_BYTES} hex digits. Make one with: pcmrs peers new NAME.", file=str(path)
        )
    return bytes.fromhex(text)
