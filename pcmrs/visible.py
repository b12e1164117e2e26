"""Escaping of text from outside, so that no character of it controls a terminal or begins a line of the log."""

from __future__ import annotations

import json


def visible(text: str, *, keep: str = "") -> str:
    r"""Return `text` with each character that is not printable written as an escape, such as ``\u001b`` or ``\n``.

    Control characters, line separators, invisible format characters and lone surrogates are escaped as in JSON, so that
    a JSON text keeps its meaning.

    Args:
        text: Text from any source.
        keep: Characters that are not escaped.
    """
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() or each in keep else json.dumps(each)[1:-1] for each in text)
