"""Keys of peers that others may use start nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.settings import PeerConfig
from pcmrs.gateway.signing import new_key
from pcmrs.testing.clock import ManualClock
from tests.unit.gateway.gateway_fakes import FakeCore
from tests.unit.gateway.signed_room import config


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604, 0o620, 0o601, 0o666])
async def test_a_key_that_others_may_use_starts_nothing(tmp_path: Path, mode: int) -> None:
    file = tmp_path / "planner.key"
    new_key(file)
    file.chmod(mode)
    with pytest.raises(ConfigurationError, match=f"chmod 600 {file}") as error:
        async with open_gateway(
            FakeCore(), config({"planner": PeerConfig(key_file=str(file))}), ManualClock(), tmp_path
        ):
            pass
    assert error.value.fields == {"file": str(file), "mode": f"{mode:04o}", "limit": "0600"}
    assert file.read_text().strip() not in error.value.text
