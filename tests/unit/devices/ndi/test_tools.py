"""Tool definitions: read whole, and checked."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from pcmrs.devices.ndi.tools import LARGEST, placeholder, read_tools
from pcmrs.errors import ConfigurationError


def test_a_tool_definition_is_read_whole_and_its_hash_checked(tmp_path: Path) -> None:
    file = tmp_path / "coil.rom"
    file.write_bytes(placeholder("coil"))
    digest = hashlib.sha256(placeholder("coil")).hexdigest()
    assert read_tools({"coil": str(file)}, {"coil": digest.upper()}) == {"coil": placeholder("coil")}
    with pytest.raises(ConfigurationError, match=r"ndi\.tools\.coil: .* is not the agreed tool definition"):
        read_tools({"coil": str(file)}, {"coil": "0" * 64})
    with pytest.raises(ConfigurationError, match=r"pointer, which ndi\.tools does not"):
        read_tools({"coil": str(file)}, {"pointer": digest})


@pytest.mark.parametrize("content", [b"", b"something else", b"NDI".ljust(LARGEST + 1, b"x")])
def test_invalid_tool_definition_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "coil.rom"
    file.write_bytes(content)
    with pytest.raises(ConfigurationError, match="is not a tool definition"):
        read_tools({"coil": str(file)}, {})


def test_a_tool_definition_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"ndi\.tools\.coil: .*none\.rom cannot be read: No such file"):
        read_tools({"coil": str(tmp_path / "none.rom")}, {})
    with pytest.raises(ConfigurationError, match="Is a directory"):
        read_tools({"coil": str(tmp_path)}, {})
