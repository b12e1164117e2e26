"""Mutants made by rule: every guard and comparison in the functions of some packages.

The rules:

- a guard, which is an `if` whose body ends with `raise`, `return`, `continue` or `break`: its condition is evaluated
  and never holds;
- a comparison holds when it did not, and the other way round;
- `<`, `<=`, `>`, `>=` with an integer or a length: the limit itself changes sides. With any other number this is rarely
  a difference that could be noticed;
- `and` becomes `or`, and the other way round.

Left out, since a mutant there is no other product or waits for ever: what is in `if TYPE_CHECKING`, in `__repr__` and
`__str__`, in `raise`, in formatted texts and calls of a logger, in `assert`, in conditions of `while`, and everything
that only an import runs.

Why not a tool: cosmic-ray runs one command of tests for all mutants, which here takes ten minutes each; it or mutmut
would be a second way of choosing and judging tests beside the one for the listed mutants.
"""

from __future__ import annotations

import ast
import random
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from tests import ROOT
from tests.mutants.places import Place
from tests.mutants.trying import Candidate

PACKAGES = (
    "dispatcher", "gateway", "journal", "devices", "workflows", "kinematics", "registration", "pki", "bus", "teleop",
    "tms", "service",
)  # fmt: skip
"""The packages in which a missing guard can do harm."""

_Function = ast.FunctionDef | ast.AsyncFunctionDef
_LEAVES = (ast.Raise, ast.Return, ast.Continue, ast.Break)
_TEXTS = {"__repr__", "__str__"}
_LOGGERS = {"log", "_log", "logger", "_logger"}
_BOUNDARIES: dict[type[ast.cmpop], ast.cmpop] = {
    ast.Lt: ast.LtE(), ast.LtE: ast.Lt(), ast.Gt: ast.GtE(), ast.GtE: ast.Gt(),
}  # fmt: skip


class Guard(msgspec.Struct, frozen=True):
    """A condition that holds something back.

    Attributes:
        module: Dotted name below ``pcmrs``.
        function: Qualified name.
        place: The condition.
        body: Lines of the first statement that is run when it holds.
    """

    module: str
    function: str
    place: Place
    body: range


def generated(tree: Path = ROOT) -> list[Candidate]:
    """Return all mutants, in the order of the files and of the lines in them."""
    found: list[Candidate] = []
    for file, source in _files(tree):
        numbers: Counter[tuple[str, str]] = Counter()
        for function, node in _nodes(ast.parse(source)):
            for kind, part, without in _mutants(node):
                numbers[function, kind] += 1
                where = f"{_module(file)}:{function}"
                place = _place(file, source, part)
                text = without or f"({place.text}) and False"
                name = f"{where}:{kind}:{numbers[function, kind]}"
                found.append(Candidate(name=name, where=where, place=place, without=text))
    return found


def sample(mutants: Sequence[Candidate], size: int, seed: int) -> list[Candidate]:
    """Draw mutants, the same ones for the same seed and sources."""
    return random.Random(seed).sample(mutants, min(size, len(mutants)))


def guards(tree: Path = ROOT) -> list[Guard]:
    """Return all guards, in the order of the files and of the lines in them."""
    return [
        Guard(_module(file), function, _place(file, source, node.test), _lines(node.body[0]))
        for file, source in _files(tree)
        for function, node in _nodes(ast.parse(source))
        if isinstance(node, ast.If) and _is_guard(node)
    ]


def _files(tree: Path) -> Iterator[tuple[Path, str]]:
    for package in PACKAGES:
        for path in sorted((tree / "pcmrs" / package).rglob("*.py")):
            yield path.relative_to(tree), path.read_text()


def _nodes(module: ast.Module) -> Iterator[tuple[str, ast.AST]]:
    """Yield what can be mutated, with the qualified name of its function."""

    def below(node: ast.AST, outer: str, function: str) -> Iterator[tuple[str, ast.AST]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, _Function):
                if child.name not in _TEXTS:
                    for statement in child.body:
                        yield from visit(statement, f"{outer}{child.name}.", f"{outer}{child.name}")
            elif isinstance(child, ast.ClassDef):
                yield from below(child, f"{outer}{child.name}.", function)
            else:
                yield from visit(child, outer, function)

    def visit(node: ast.AST, outer: str, function: str) -> Iterator[tuple[str, ast.AST]]:
        if isinstance(node, (_Function, ast.ClassDef)):
            yield from below(ast.Module([node], []), outer, function)
        elif not _is_left_out(node):
            if function:
                yield function, node
            if isinstance(node, ast.While):
                for statement in (*node.body, *node.orelse):
                    yield from visit(statement, outer, function)
            else:
                yield from below(node, outer, function)

    yield from below(module, "", "")


def _is_left_out(node: ast.AST) -> bool:
    match node:
        case ast.Raise() | ast.Assert() | ast.JoinedStr():
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case ast.Call(func=ast.Attribute(value=ast.Name(id=name) | ast.Attribute(attr=name))):
            return name in _LOGGERS
    return False


def _mutants(node: ast.AST) -> Iterator[tuple[str, ast.expr, str]]:
    """Yield the kind of each mutant, the expression that it replaces and the text that takes its place."""
    match node:
        case ast.If() if _is_guard(node):
            yield "guard", node.test, ""
        case ast.BoolOp():
            other = ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
            yield "junction", node, f"({ast.unparse(other)})"
        case ast.Compare():
            yield "comparison", node, f"(not ({ast.unparse(node)}))"
            sides = (node.left, *node.comparators)
            if len(node.ops) == 1 and type(node.ops[0]) in _BOUNDARIES and any(_counts(side) for side in sides):
                moved = ast.Compare(node.left, [_BOUNDARIES[type(node.ops[0])]], node.comparators)
                yield "limit", node, f"({ast.unparse(moved)})"


def _is_guard(node: ast.If) -> bool:
    return isinstance(node.body[-1], _LEAVES)


def _counts(node: ast.expr) -> bool:
    """Tell an integer or a length."""
    match node:
        case ast.Constant(value=int()):
            return True
        case ast.Call(func=ast.Name(id="len")):
            return True
    return False


def _place(file: Path, source: str, node: ast.expr) -> Place:
    lines = source.splitlines(keepends=True)

    def offset(line: int, column: int) -> int:
        return sum(len(each) for each in lines[: line - 1]) + len(lines[line - 1].encode()[:column].decode())

    start = offset(node.lineno, node.col_offset)
    end = offset(node.end_lineno or node.lineno, node.end_col_offset or 0)
    return Place(file, start, source[start:end])


def _lines(statement: ast.stmt) -> range:
    return range(statement.lineno, (statement.end_lineno or 0) + 1)


def _module(file: Path) -> str:
    names = file.with_suffix("").parts[1:]
    return ".".join(names[:-1] if names[-1] == "__init__" else names)
