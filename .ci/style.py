"""Rejects phrases that the project no longer uses, and docstrings that begin in the third person.

CONTRIBUTING.md ("How we write") says how to write instead.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = (
    "*.md",
    "docs/*.md",
    "docs/adr/*.md",
    "docs/api/*.md",
    "deploy/**/*.md",
    "deploy/**/*.py",
    ".github/**/*.md",
    "pcmrs/**/*.py",
    "pcmrs/**/*.j2",
    "clients/**/*.py",
    "clients/**/*.cs",
    "clients/**/*.md",
    "sim/**/*.py",
    "lab/**/*.py",
    "lab/**/*.md",
    "lab/**/*.toml",
    "lab/**/*.j2",
    "benchmarks/*.py",
    "examples/**/*.py",
    "fuzz/*.py",
)
"""Files that are checked, as patterns below the root."""
LEFT_OUT = (
    "CHANGELOG.md",
    "benchmarks/stop_real.py",
    "benchmarks/stop_stamps.py",
    "docs/evidence.md",
    "docs/progress.md",
    "pcmrs/journal/notes.py",
    "pcmrs/service/restart/recorder.py",
)
"""History, names of times in reports, a generated page, the notes of an issue, and texts that stand in journals."""
QUOTED = re.compile(r"```.*?```|`[^`\n]+`|(?<=\n\n)(?: {4}[^\n]*\n+)+", re.DOTALL)
"""Code and output of programs in a page."""
NAMED = re.compile(r"`[^`\n]+`")
"""Names in the text of a Python file."""
PHRASES = {
    r"anew": "again; restarted",
    r"(?:is|are|was|were|be|been|being) begun": "started",
    r"begun again": "restarted",
    r"of (?:its|their|his|your|our|one's) own(?: accord)?": "its own …; by itself",
    r"who(?:so)?ever": "anyone who",
    r"nobody knows": "unknown",
    r"told": "reported, logged, published; set to",
    r"heard of": "known",
    r"of late": "recent",
    r"of before": "earlier",
    r"for ever": "permanently; never … again",
    r"(?:in the way of|in (?:its|their|each other's) way)": "conflicts with; blocks",
    r"(?:come|comes|came) about": "happen",
    r"(?:bring|brings|bringing|brought)(?: \w+)? about": "cause; inject",
    r"turned away": "refused, rejected",
    r"under way": "running, in progress; pending",
    r"(?:take|takes|taken|took) up(?! to)": "open; continue; adopt",
    r"come to (?:its|their|an) end": "ended; closed",
    r"what is (?:not|no)": "name the thing: missing values, unlisted keys",
    r"who asks": "the caller; the client",
    r"is no \w+ (?:of|beside)": "unknown …; did you mean …?",
    r"over and over": "repeatedly",
    r"but for": "except",
    r"mend(?:s|ed|ing)?": "fix, repair",
    r"in vain": "without effect",
    r"hears? of": "is announced to",
    r"lets? go on": "continue",
}
"""What is no longer used, and what to write."""
UNUSED = re.compile(
    "|".join(rf"(?P<p{number}>\b{phrase}\b)" for number, phrase in enumerate(PHRASES)).replace(" ", r"\s+"),
    re.IGNORECASE,
)

VERBS = (
    r"Adds|Admits|Answers|Appends|Applies|Asks|Begins|Binds|Blocks|Brings|Builds|Called|Calls|Cancels|"
    r"Changes|Checks|Clears|Closes|Collects|Compares|Computes|Concludes|Connects|Converts|Copies|Counts|"
    r"Creates|Decides|Decodes|Deletes|Describes|Determines|Disconnects|Does|Drains|Draws|Drops|Encodes|"
    r"Ends|Expands|Feeds|Finds|Follows|Forgets|Formats|Gets|Gives|Handles|Has|Holds|Ignores|Injects|"
    r"Implements|Installs|Keeps|Kills|Lets|Listens|Loads|Logs|Looks|Makes|Merges|Moves|Notifies|Opens|Parses|"
    r"Passes|Performs|Plans|Prepares|Presses|Prints|Publishes|Puts|Raises|Reads|Receives|Records|"
    r"Refuses|Registers|Rejects|Releases|Removes|Reopens|Repeats|Replaces|Reports|Resets|Restarts|"
    r"Resumes|Returns|Runs|Says|Sends|Serves|Sets|Shows|Signs|Splits|Starts|Stops|Stores|Submits|"
    r"Takes|Tells|Tests|Treats|Tries|Turns|Updates|Validates|Verifies|Waits|Warns|Watches|Wraps|Writes|"
    r"Yields"
)
"""First words of a docstring in the third person."""
THIRD_PERSON = re.compile(rf"\s*({VERBS})\b(?! of\b)")
"""Before "of", the word is a noun: "Reports of the seeds."."""
IMPERATIVE = "an imperative or a noun phrase"


def findings(text: str, code: re.Pattern[str] = QUOTED) -> Iterator[tuple[int, str, str]]:
    """Yield line, phrase and advice for each phrase of a text that is no longer used.

    Args:
        text: The text.
        code: Pattern of the code in it, which is not checked.
    """
    plain = code.sub(_blank, text)
    for found in UNUSED.finditer(plain):
        advice = list(PHRASES.values())[int((found.lastgroup or "p0")[1:])]
        yield plain.count("\n", 0, found.start()) + 1, " ".join(found[0].split()), advice


def third_persons(source: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, first word and advice for each docstring of a function or class that begins in the third person."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found = THIRD_PERSON.match(ast.get_docstring(node, clean=False) or "")
            if found:
                yield node.body[0].lineno, found[1], IMPERATIVE


def prose(source: str) -> str:
    """Return the comments and strings of a Python file, each where it was."""
    lines = [_blank(line) for line in source.splitlines(keepends=True)]
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type in (tokenize.COMMENT, tokenize.STRING):
            for row, text in enumerate(token.string.splitlines(keepends=True), start=token.start[0] - 1):
                begin = token.start[1] if row == token.start[0] - 1 else 0
                lines[row] = lines[row][:begin] + text.rstrip("\n") + lines[row][begin + len(text.rstrip("\n")) :]
    return "".join(lines)


def _blank(text: str | re.Match[str]) -> str:
    """Return as many characters that part phrases."""
    return re.sub(r"[^\n]", "\0", text if isinstance(text, str) else text[0])


def _findings_in(path: Path) -> Iterator[tuple[int, str, str]]:
    text = path.read_text()
    if path.suffix != ".py":
        yield from findings(text)
        return
    yield from findings(prose(text), NAMED)
    yield from third_persons(text)


def main() -> int:
    """Print the findings of all files; the exit status is 1 if there are any."""
    files = {path for pattern in FOLDERS for path in ROOT.glob(pattern)} - {ROOT / name for name in LEFT_OUT}
    lines = [
        f"{path.relative_to(ROOT)}:{line}: '{phrase}' is no longer used; write: {advice}\n"
        for path in sorted(files)
        for line, phrase, advice in _findings_in(path)
    ]
    sys.stdout.writelines(lines)
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
