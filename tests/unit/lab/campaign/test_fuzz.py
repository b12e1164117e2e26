"""Fuzzed datagrams ask for nothing that could change a cell, and cover the grammar's refusals."""

from __future__ import annotations

import random

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import PayloadError
from pcmrs.gateway.commands import COMMANDS
from pcmrs.gateway.grammar import parse, parse_tool_points
from pcmrs_lab.campaign.fuzz import HARMLESS, datagram


@given(seed=st.integers(0, 1 << 32))
def test_fuzzed_datagram_that_parses_is_harmless(seed: int) -> None:
    generator = random.Random(seed)
    for _ in range(50):
        sent = datagram(generator)
        try:
            assert parse_tool_points(sent) is None
            request = parse(sent)
        except PayloadError:
            continue
        assert request.spec.action in HARMLESS


def test_every_command_and_every_reason_for_refusing_comes_up() -> None:
    generator = random.Random(1)
    names, reasons = set(), set()
    for _ in range(20_000):
        sent = datagram(generator)
        names.add(sent[:16])
        try:
            parse(sent)
        except PayloadError as error:
            reasons.add(next((word for word in REASONS if word in error.text), error.text))
    assert reasons == set(REASONS)
    assert {name.encode() for name in COMMANDS} <= names


REASONS = (
    "is not a command",
    "no terminator",
    "follows the terminator",
    "not printable",
    "the limit is 256",
    "tokens, got",
    "tokens start with",
    "finite decimal",
    "takes an index",
)
