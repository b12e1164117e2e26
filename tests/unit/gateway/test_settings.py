"""Settings of the gateway that no cell may have."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.gateway.settings import MAX_PEERS, GatewayConfig, OpenIgtLinkConfig
from pcmrs.hosts import is_loopback


@pytest.mark.parametrize("host", ["localhost", "planner.local", "127.0.0.1.example.org", "", "192.0.2.1", "::2"])
def test_a_name_is_never_taken_for_this_machine(host: str) -> None:
    """Somebody else may say where it leads."""
    assert not is_loopback(host)
    with pytest.raises(ConfigurationError, match="loopback"):
        GatewayConfig(unsigned_peers=(host,))


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_stream_has_a_rate(rate: float) -> None:
    with pytest.raises(ConfigurationError, match="greater than 0"):
        GatewayConfig(stream_rate_hz=rate)


@pytest.mark.parametrize("field", ["client_host", "mixed_reality_host"])
@pytest.mark.parametrize("host", ["headset.local", "::1", "", "192.0.2.300"])
def test_streams_go_to_ipv4_addresses_only(field: str, host: str) -> None:
    with pytest.raises(ConfigurationError, match=f"{field} is '{host}'") as error:
        msgspec.convert({field: host}, GatewayConfig)
    assert error.value.fields == {field: host}


def test_only_loopback_peers_may_be_listed() -> None:
    with pytest.raises(ConfigurationError, match="loopback"):
        GatewayConfig(unsigned_peers=("192.0.2.1",))


@pytest.mark.parametrize(
    "values",
    [
        {"role": "client", "port": 0},
        {"rate_hz": 0.0},
        {"rate_hz": math.nan},
        {"target": ""},
        {"target": "TargetToImage"},
        {"landmarks": "x" * 21},
    ],
)
def test_the_table_is_checked(values: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match="openigtlink"):
        msgspec.convert(values, OpenIgtLinkConfig)


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
