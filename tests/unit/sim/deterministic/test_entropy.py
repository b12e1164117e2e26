"""Identifiers in simulated time are drawn from the seed."""

from __future__ import annotations

import uuid

from pcmrs_sim.deterministic.entropy import seeded_entropy


def test_identifiers_are_drawn_from_the_seed_and_only_meanwhile() -> None:
    with seeded_entropy(7):
        first = uuid.uuid4()
    with seeded_entropy(7):
        assert uuid.uuid4() == first
    assert uuid.uuid4() != first
