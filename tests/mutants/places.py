"""Places in the product, found by qualified name, so that what is said of them survives moved files."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import msgspec

TOPS = ("pcmrs", "sim", "lab")
"""Folders of the distributions."""
DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


class Place(msgspec.Struct, frozen=True):
    """A text in the source of a function.

    Attributes:
        file: Below the tree.
        start: Offset of its first character in the file.
        text: The text itself.
    """

    file: Path
    start: int
    text: str

    def replaced(self, tree: Path, text: str) -> str:
        """Return the file's source with another text in this place."""
        source = (tree / self.file).read_text()
        return source[: self.start] + text + source[self.start + len(self.text) :]


@lru_cache
def definitions(source: str) -> tuple[tuple[str, int, int], ...]:
    """Return the qualified name of every class and function, its first line (of its decorators) and its last one."""

    def below(node: ast.AST, outer: str) -> Iterator[tuple[str, int, int]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, DEFINITIONS):
                name = f"{outer}{child.name}"
                yield name, min([child.lineno, *(each.lineno for each in child.decorator_list)]), child.end_lineno or 0
                yield from below(child, f"{name}.")
            else:
                yield from below(child, outer)

    return tuple(below(ast.parse(source), ""))


def find(tree: Path, module: str, function: str, text: str) -> Place:
    """Find a text in a function.

    A function that its module no longer has is looked for in the whole product.

    Args:
        tree: Root of the sources.
        module: Dotted name below ``pcmrs``; other modules begin with ``pcmrs_sim`` or ``pcmrs_lab``.
        function: Qualified name of a function or class; empty for the whole module.
        text: Must occur once in the function.

    Raises:
        ValueError: The function or the text is nowhere, or the text is in several places.
    """
    path = Path(*module.split("."))
    candidates = [
        each
        for base in (path, *(Path(top) / path for top in TOPS))
        for each in (base.with_suffix(".py"), base / "__init__.py")
    ]
    files = [file for file in candidates if (tree / file).is_file()]
    places = [place for file in files for place in _places(tree, file, function, text)]
    if not places and function:
        everywhere = sorted(file.relative_to(tree) for top in TOPS for file in (tree / top).rglob("*.py"))
        places = [place for file in everywhere for place in _places(tree, file, function, text)]
    if len(places) != 1:
        where = ", ".join(str(place.file) for place in places) or "nowhere"
        raise ValueError(
            f"The text {text!r} must occur once in {function or 'the module'} of {module}; it occurs {len(places)}"
            f" times: {where}. If the function was renamed or its text changed, correct the entry."
        )
    return places[0]


def _places(tree: Path, file: Path, function: str, text: str) -> Iterator[Place]:
    source = (tree / file).read_text()
    if text not in source:
        return
    lines = source.splitlines(keepends=True)
    spans = (
        [(0, len(lines))] if not function else [(a - 1, b) for name, a, b in definitions(source) if name == function]
    )
    for first, last in spans:
        offset, part = len("".join(lines[:first])), "".join(lines[first:last])
        start = part.find(text)
        while start >= 0:
            yield Place(file, offset + start, text)
            start = part.find(text, start + 1)
