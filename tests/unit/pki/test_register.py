"""The register of identities is read whole, or not at all."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.messages.identity import Identity
from pcmrs.pki import Authority
from pcmrs.pki._register import read_register

ROW = {"name": "anna", "role": "operator", "serial": "1", "begins": 0.0, "ends": 1.0}


def test_old_register_marks_nobody_and_the_name_local_is_refused(authority: Authority) -> None:
    row = ROW | {"cells": ["lab/c1"]}
    register = authority.folder / "register.json"
    register.write_text(json.dumps([row]))
    assert [each.via for each in authority.identities()] == [()]
    register.write_text(json.dumps([row | {"name": "local"}]))
    with pytest.raises(ConfigurationError, match="choose another one"):
        authority.identities()


def test_a_register_is_read_as_it_was_written(tmp_path: Path) -> None:
    identities = [
        Identity(name="anna", role="operator", serial="1f", begins=1.0, ends=2.0, cells=("lab/c1",), via=("gate",)),
        Identity(name="bob", role="viewer", serial="20", begins=1.0, ends=2.0, cells=("lab/c1",), revoked=1.5),
    ]
    file = tmp_path / "register.json"
    file.write_bytes(msgspec.json.encode(identities))
    assert read_register(file) == identities


@pytest.mark.parametrize(
    "content",
    [
        None,
        b"",
        b"{}",
        b'[{"name": "anna", "cells": ["lab/c1"]}]',
        b'[{"name": "a", "role": "surgeon", "serial": "1", "begins": 0, "ends": 1, "cells": []}]',
    ],
)
def test_a_damaged_register_is_refused_with_the_remedy(tmp_path: Path, content: bytes | None) -> None:
    """An empty one would let revoked identities in again."""
    file = tmp_path / "register.json"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigurationError, match=r"register\.json cannot be read.*Put it back from a copy") as refused:
        read_register(file)
    assert refused.value.fields == {"path": str(file)}


@pytest.mark.parametrize("revoked", [None, 0.5])
def test_entry_without_cells_is_refused_with_the_remedy(authority: Authority, revoked: float | None) -> None:
    """In an early version it was valid for every cell."""
    register = authority.folder / "register.json"
    row = ROW | {"revoked": revoked}
    register.write_text(json.dumps([row | {"name": "bob", "cells": ["lab/c1"]}, row]))
    with pytest.raises(ConfigurationError, match=r"'anna' names no cells\. Add the cells .*daemons") as refused:
        authority.issue("operator", "eve", 0.0, cells=["lab/c1"], into=authority.folder)
    assert refused.value.fields == {"path": str(register), "name": "anna"}
    assert not (authority.folder / "eve").exists()
    register.write_text(json.dumps([row | {"cells": ["lab/c1"]}]))
    assert [each.cells for each in authority.identities()] == [("lab/c1",)]
