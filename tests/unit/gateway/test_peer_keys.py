"""New keys for peers, by the command line, and keys that start nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.gateway.commands import DEFAULT
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.settings import PeerConfig
from pcmrs.gateway.signing import new_key, read_key
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


@pytest.mark.parametrize("mode", [0o600, 0o400])
def test_key_readable_by_its_owner_only_is_read(tmp_path: Path, mode: int) -> None:
    file = tmp_path / "planner.key"
    new_key(file)
    file.chmod(mode)
    assert len(read_key(file)) == 32


@pytest.mark.parametrize("content", ["", "0" * 63, "0" * 65, "g" * 64, "0" * 64 + "\n\n", "é" * 64])
def test_a_file_without_a_key_is_refused_and_not_shown(tmp_path: Path, content: str) -> None:
    file = tmp_path / "planner.key"
    file.touch(mode=0o600)
    file.write_text(content, encoding="utf-8")
    with pytest.raises(ConfigurationError, match="holds no key: 64 hex digits") as error:
        read_key(file)
    assert not content.strip() or content.strip() not in error.value.text


def test_a_missing_key_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="pcmrs peers new"):
        read_key(tmp_path / "none.key")


def test_keys_differ(tmp_path: Path) -> None:
    new_key(tmp_path / "a")
    new_key(tmp_path / "b")
    assert read_key(tmp_path / "a") != read_key(tmp_path / "b")


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ({"a": {}}, "key_file"),
        ({"a": {"key_file": "a.key"}}, "absolute"),
        (
            {"a": {"key_file": "/a.key", "allow": ["fly"]}},
            "'fly', which is neither a command nor one of",
        ),
        ({"a": {"key_file": "/a.key", "rate": 0}}, "greater than 0"),
        ({"a": {"key_file": "/a.key", "rate": float("nan")}}, "greater than 0"),
        ({"a": {"key_file": "/a.key", "rate": float("inf")}}, "greater than 0"),
        ({"a": {"key_file": "/a.key", "burst": 0}}, "1 or more"),
        ({"a": {"key_file": "/a.key", "key": "00"}}, "unknown field `key`"),
        ({"a": {"key_file": "/a.key", "counter": "unix_ms"}}, "unix_ms"),
        ({"a|b": {"key_file": "/a.key"}}, "1 to 32 letters"),
        ({"a" * 33: {"key_file": "/a.key"}}, "1 to 32 letters"),
        ({f"a{number}": {"key_file": "/a.key"} for number in range(MAX_PEERS + 1)}, f"limit is {MAX_PEERS}"),
        ({"local": {"key_file": "/a.key"}}, "own machine"),
        ({"Local": {"key_file": "/a.key"}}, "own machine"),
    ],
)
def test_a_wrong_table_is_refused(table: dict[str, Any], text: str) -> None:
    with pytest.raises((ConfigurationError, msgspec.ValidationError), match=text):
        msgspec.convert({"peers": table}, GatewayConfig)


def test_every_command_but_stop_is_in_one_group() -> None:
    grouped = [name for group in GROUPS.values() for name in group]
    assert sorted([*grouped, STOP]) == sorted(COMMANDS)


def test_whatever_drives_the_robot_is_in_no_group_of_the_default() -> None:
    for name in allowed(DEFAULT):
        assert all(step.branch not in ("placement", "robot") for step in COMMANDS[name].steps), name
    assert {name for name, spec in COMMANDS.items() if any(step.branch == "placement" for step in spec.steps)} == set(
        GROUPS["motion"]
    )


def test_commands_may_be_listed_and_stop_is_always_allowed() -> None:
    assert allowed(["execute_homexxxx"]) == {"execute_homexxxx", STOP}
    assert allowed([]) == {STOP}
