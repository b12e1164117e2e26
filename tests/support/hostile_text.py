"""Text of other people that tries to act on a terminal or to forge a line, and the check that it does neither."""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout

from hypothesis import strategies as st

PIECES = st.text() | st.sampled_from(
    [
        "[/x]",
        "[bold red]",
        "[link=https://example.org]x[/link]",
        ":warning:",
        "\\[",
        "\x1b[2J",
        "\x9b2K",
        "\n",
        "\u202e",
    ]
)
HOSTILE = st.lists(PIECES, max_size=4).map("".join)
FORGING = "[link=https://example.org]x[/link]\x1b[2J\nforged: released\u202e\x9b2K"
"""Text that hides what is before it and begins a line of its own."""


def printed(work: Callable[[str], None], text: str) -> list[str]:
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as errors:
        work(text)
    return (out.getvalue() + errors.getvalue()).split("\n")


def check_no_effect(work: Callable[[str], None], text: str, *, titled: bool = False) -> None:
    """Assert that printed text is only shown: it controls nothing and forges no line.

    Args:
        work: Prints the text.
        text: Text of other people.
        titled: True if the title of a table wraps, so that the number of lines depends on its width.
    """
    shown = printed(work, text)
    assert all(line.isprintable() for line in shown)
    assert not [line for line in shown if line.strip(" │┃").startswith("forged")]
    if not titled:
        assert len(shown) == len(printed(work, "x")), "no line is forged"
