"""The style check of `make lint` finds phrases that are no longer used, and pages have none."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys

import pytest

from tests import ROOT

PROGRAM = ROOT / ".ci" / "style.py"

spec = importlib.util.spec_from_file_location("style", PROGRAM)
assert spec is not None
assert spec.loader is not None
style = importlib.util.module_from_spec(spec)
spec.loader.exec_module(style)


@pytest.mark.parametrize(
    ("planted", "phrase"),
    [
        ("The node is begun anew.", "is begun"),
        ("It runs in a process of its\n  own.", "of its own"),
        ("Whoever may stop it, stops it.", "Whoever"),
        ("The operator is told why.", "told"),
        ("'x' is no step beside it.", "is no step beside"),
    ],
)
def test_a_planted_phrase_is_found_with_its_line(planted: str, phrase: str) -> None:
    line, found, advice = next(iter(style.findings(f"# Page\n\nPlain.\n{planted}\n")))
    assert (line, found) == (4, phrase)
    assert advice


@pytest.mark.parametrize(
    "text",
    ["Not `begun anew`.\n", "```console\n$ program\ntold you\n```\n", "So:\n\n    told you\n", "It takes up to 5 s.\n"],
)
def test_quotations_and_output_of_programs_are_left_out(text: str) -> None:
    assert list(style.findings(text)) == []


def test_pages_have_none() -> None:
    ended = subprocess.run([sys.executable, PROGRAM], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (0, "")


@pytest.mark.parametrize(
    "planted",
    [
        "import click\n\nclick.echo('x')\n",
        "from rich.text import Text\n",
        "from rich.console import Console\n",
        "from rich.markup import escape\n",
        "import logging\n\nlogging.basicConfig()\n",
    ],
)
def test_output_that_does_not_escape_is_found_by_the_linter(planted: str) -> None:
    command = ["ruff", "check", "--select", "TID251", "--output-format", "json"]
    command += ["--stdin-filename", "pcmrs/cli/planted.py", "-"]
    ended = subprocess.run(
        [sys.executable, "-m", *command], input=planted, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert [found["code"] for found in json.loads(ended.stdout)] == ["TID251"]


def test_only_comments_and_strings_of_python_files_are_read() -> None:
    source = 'told = "restarted"  # begun anew\n\n\ndef run() -> None:\n'
    source += '    """Say what was told.\n\n    Of `told` values.\n    """\n'
    found = [(line, phrase) for line, phrase, _ in style.findings(style.prose(source), style.NAMED)]
    assert found == [(1, "anew"), (5, "told")]


@pytest.mark.parametrize(
    ("docstring", "word"),
    [
        ("Returns the pose.", "Returns"),
        ("\n    Called by the parser.", "Called"),
        ("Return the pose.", None),
        ("Reports of the seeds.", None),
        ("Runs.", "Runs"),
    ],
)
def test_a_docstring_in_the_third_person_is_found(docstring: str, word: str | None) -> None:
    source = f'class Sender:\n    """Sender."""\n\n    async def run(self) -> None:\n        """{docstring}"""\n'
    found = [(line, phrase) for line, phrase, _ in style.third_persons(source)]
    assert found == ([] if word is None else [(5, word)])


def test_so_is_that_of_a_class() -> None:
    assert [line for line, *_ in style.third_persons('class Sender:\n    """Sends beats."""\n')] == [2]
