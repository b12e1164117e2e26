"""Calls of device methods by name."""

from __future__ import annotations

from typing import Any

import pytest

from tests.unit.devices.node_bench import Bench


@pytest.mark.parametrize(
    ("method", "arguments", "text"),
    [
        ("explode", {}, "no method 'explode'"),
        ("states", {}, "no method 'states'"),
        ("servo", {}, "no method 'servo'"),
        ("__init__", {}, "no method '__init__'"),
        ("follow", {}, r"follow takes \['trajectory'\]"),
        ("joints", {"fast": True}, r"joints takes \[\]"),
        ("follow", {"trajectory": {"period": "soon", "positions": []}}, "Expected `float`"),
    ],
)
async def test_unknown_call_is_answered_with_the_known_ones(
    bench: Bench, method: str, arguments: dict[str, Any], text: str
) -> None:
    reply = await bench.raw("robot", method, **arguments)
    assert reply.failure is not None
    assert reply.failure.code == "malformed"
    with pytest.raises(AssertionError, match=text):
        raise AssertionError(reply.failure.text)
