"""Joint states as integers: each digit holds every state of its branch."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm.verify._encoding import Batch, Encoding


@given(st.lists(st.integers(1, 5), min_size=1, max_size=8), st.data())
def test_a_code_means_the_combination_it_was_made_of(sizes: list[int], data: st.DataObject) -> None:
    encoding = Encoding({f"b{n}": [str(value) for value in range(size)] for n, size in enumerate(sizes)})
    values = {
        name: data.draw(st.sampled_from(taken)) for name, taken in zip(encoding.names, encoding.values, strict=True)
    }
    code = encoding.code(values)
    assert 0 <= code < encoding.combinations
    assert encoding.decoded(code) == values
    assert [str(encoding.digit(code, position)) for position in range(len(sizes))] == list(values.values())


@pytest.mark.parametrize("size", [2, 256, 257, 65_536, 65_537, 70_000])
def test_a_digit_holds_every_value_of_a_branch(size: int) -> None:
    encoding = Encoding({"first": [str(value) for value in range(size)], "second": ["a", "b"]})
    states = [{"first": str(value), "second": "b"} for value in (0, size // 2, size - 1)]
    batch = Batch(encoding, np.array([encoding.code(state) for state in states]))
    assert batch.digits[0].tolist() == [0, size // 2, size - 1]
    assert [encoding.decoded(int(code)) for code in batch.codes] == states
