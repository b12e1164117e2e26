"""Rejects phrases that the project no longer uses; CONTRIBUTING.md ("How we write") says how to write instead."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("*.md", "docs/*.md", "docs/adr/*.md", "deploy/**/*.md", ".github/**/*.md")
"""Files that are checked, as patterns below the root."""
LEFT_OUT = ("CHANGELOG.md", "docs/evidence.md", "docs/progress.md")
"""History, a generated page, and the notes of an issue."""
QUOTED = re.compile(r"```.*?```|`[^`\n]+`|(?<=\n\n)(?: {4}[^\n]*\n+)+", re.DOTALL)
"""Code and output of programs in a page."""
PHRASES = {
    r"anew": "again; restarted",
    r"(?:is|are|was|were|be|been|being) begun": "started",
    r"begun again": "restarted",
    r"of (?:its|their|his|your|our|one's) own(?: accord)?": "its own …; by itself",
    r"who(?:so)?ever": "anyone who",
    r"nobody knows": "unknown",
    r"told": "reported, logged, published; set to",
    r"heard(?: of)?": "received; known",
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


def findings(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, phrase and advice for each phrase of a text that is no longer used."""
    plain = QUOTED.sub(lambda code: re.sub(r"[^\n]", "`", code[0]), text)
    for found in UNUSED.finditer(plain):
        advice = list(PHRASES.values())[int((found.lastgroup or "p0")[1:])]
        yield plain.count("\n", 0, found.start()) + 1, " ".join(found[0].split()), advice


def main() -> int:
    """Print the findings of all files; the exit status is 1 if there are any."""
    files = {path for pattern in FOLDERS for path in ROOT.glob(pattern)} - {ROOT / name for name in LEFT_OUT}
    lines = [
        f"{path.relative_to(ROOT)}:{line}: '{phrase}' is no longer used; write: {advice}\n"
        for path in sorted(files)
        for line, phrase, advice in findings(path.read_text(encoding="utf-8"))
    ]
    sys.stdout.writelines(lines)
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
