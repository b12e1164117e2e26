"""Texts of the page, in the languages of `texts.toml`."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path

_FILE = Path(__file__).with_name("texts.toml")


@cache
def languages() -> tuple[str, ...]:
    """Return all languages; the first is the default."""
    return tuple(_texts())


@cache
def _texts() -> dict[str, dict[str, str]]:
    return tomllib.loads(_FILE.read_text(encoding="utf-8"))


class Texts:
    """The texts of one language.

    Args:
        language: One of `languages`; the first one instead of any other.
    """

    def __init__(self, language: str) -> None:
        self.language = language if language in languages() else languages()[0]
        self._texts = _texts()[self.language]

    def __call__(self, key: str, **values: object) -> str:
        """Return the text of `key`, with `values` in it."""
        return self._texts[key].format(**values)
