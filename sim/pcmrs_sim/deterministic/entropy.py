"""Randomness of the operating system, replaced by a seeded one for the length of a simulation."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def seeded_entropy(seed: int) -> Iterator[None]:
    """Has `os.urandom`, and so `uuid.uuid4`, draw from `seed`: what is journalled is then the same in every run.

    Only for a process that does nothing else meanwhile: a key made now would be no secret.
    """
    draw, real = random.Random(f"entropy {seed}"), os.urandom
    os.urandom = draw.randbytes
    try:
        yield
    finally:
        os.urandom = real
