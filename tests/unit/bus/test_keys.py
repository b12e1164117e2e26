"""Keys: building, taking apart, and the table."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.bus import KEYS, KeyTable
from pcmrs.bus.codec import pack, unpack
from pcmrs.bus.keys import MAX_CHUNK, cell_prefix, command_key, split_command_key
from pcmrs.errors import PayloadError

chunks = st.from_regex(r"[a-z0-9][a-z0-9._-]{0,20}", fullmatch=True)


@given(chunks, chunks, chunks)
def test_a_command_key_comes_apart_as_it_was_built(user: str, branch: str, operation: str) -> None:
    assert split_command_key(command_key(user, branch, operation)) == (user, branch, operation)


@pytest.mark.parametrize("name", ["", "Upper", "a/b", "*", "a**", "a b", "ä", ".a", "a\n", "$*", "a#", "a?"])
def test_a_name_that_would_change_the_key_is_refused(name: str) -> None:
    with pytest.raises(PayloadError):
        command_key("local", name, "reinit")
    with pytest.raises(PayloadError):
        cell_prefix("lab", name)


def test_the_table_crosses_the_bus() -> None:
    table = KeyTable(prefix=cell_prefix("lab", "cell1"), keys=KEYS)
    assert unpack(pack(table), KeyTable) == table


def test_a_longer_name_than_anything_has_is_refused() -> None:
    """Its sender would choose how much of the journal a rejected command takes."""
    assert command_key("local", "a" * MAX_CHUNK, "reinit") == f"cmd/local/{'a' * MAX_CHUNK}/reinit"
    for length in (MAX_CHUNK + 1, 60_000):
        with pytest.raises(PayloadError, match=f"1 to {MAX_CHUNK} lower-case") as refused:
            split_command_key(f"cmd/local/toolplan/{'a' * length}")
        assert len(refused.value.text) < 4 * MAX_CHUNK
