"""The page says everything in every language, with the same values in it."""

from __future__ import annotations

import re
import string
import tomllib
from pathlib import Path

import pcmrs
from pcmrs.console.texts import Texts, languages

CONSOLE = Path(pcmrs.__file__).parent / "console"
TEXTS = tomllib.loads((CONSOLE / "texts.toml").read_text(encoding="utf-8"))


def values(text: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(text) if name is not None}


def test_every_language_has_every_text_with_the_same_values() -> None:
    english = TEXTS["en"]
    for language in languages():
        assert TEXTS[language].keys() == english.keys()
        for key, text in TEXTS[language].items():
            assert values(text) == values(english[key]), key


def test_the_page_uses_every_text_and_no_other() -> None:
    source = "".join(file.read_text(encoding="utf-8") for file in CONSOLE.rglob("*.py"))
    named = set(re.findall(r"""["'](\w+)["']""", source))
    assert TEXTS["en"].keys() <= named
    assert set(re.findall(r'texts\(\s*"(\w+)"', source)) <= TEXTS["en"].keys()


def test_an_unknown_language_is_the_first_one() -> None:
    assert Texts("xx")("stop") == Texts(languages()[0])("stop")
