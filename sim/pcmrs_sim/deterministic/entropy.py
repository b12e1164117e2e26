"""A seeded source in place of the operating system's randomness, for the length of a simulation."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def seeded_entropy(seed: int) -> Iterator[None]:
    """Make `os.urandom`, and so `uuid.uuid4`, draw from `seed`, so that the journal is the same in each run.

    Use it only in a process that does nothing else meanwhile: a key that is made now is not secret.
    """
    draw, real = random.Random(f"entropy {seed}"), os.urandom
    os.urandom = draw.randbytes
    try:
        yield
    finally:
        os.urandom = real
