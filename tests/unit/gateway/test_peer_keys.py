"""New keys for peers, by the command line, and keys that start nothing."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs.errors import ConfigurationError
from pcmrs.gateway.commands import DEFAULT
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.settings import PeerConfig
from pcmrs.gateway.signing import new_key, read_key
from pcmrs.settings import read_settings
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


def run(*words: str) -> Result:
    return CliRunner().invoke(main, ["peers", "new", *words])


def test_a_new_key_comes_with_the_table_that_uses_it(tmp_path: Path) -> None:
    ended = run("planner", "--folder", str(tmp_path))
    assert ended.exit_code == 0
    file = tmp_path / "planner.key"
    assert file.stat().st_mode & 0o777 == 0o600
    assert read_key(file).hex() not in ended.output
    (tmp_path / "cell.toml").write_text(ended.stdout)
    settings = read_settings(tmp_path / "cell.toml")
    assert settings.gateway.peers == {"planner": PeerConfig(key_file=str(file), counter="unix_ns")}
    assert tomllib.loads(ended.stdout)["gateway"]["peers"]["planner"]["allow"] == list(DEFAULT)


def test_as_json(tmp_path: Path) -> None:
    ended = run("planner", "--folder", str(tmp_path), "--json")
    assert json.loads(ended.stdout) == {
        "peer": "planner", "key_file": str(tmp_path / "planner.key"), "allow": list(DEFAULT), "counter": "unix_ns",
    }  # fmt: skip


def test_a_key_that_is_there_stays(tmp_path: Path) -> None:
    assert run("planner", "--folder", str(tmp_path)).exit_code == 0
    before = (tmp_path / "planner.key").read_bytes()
    ended = run("planner", "--folder", str(tmp_path))
    assert ended.exit_code == 4
    assert "planner.key exists" in ended.stderr
    assert (tmp_path / "planner.key").read_bytes() == before


@pytest.mark.parametrize("name", ["a/b", "..", "a b", "a" * 33])
def test_invalid_name_makes_no_file(tmp_path: Path, name: str) -> None:
    ended = run(name, "--folder", str(tmp_path))
    assert ended.exit_code == 4
    assert "1 to 32 letters" in ended.stderr
    assert list(tmp_path.iterdir()) == []
