"""Codes and texts of refusals, read from the source because reasons are values and not types."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PLACES = {"RefusalError": (0, 1), "Reason": (0, 1), "Denial": (0, 1), "RegistrationGate": (0, 4)}
"""Positions of code and text among the arguments of a call that makes a refusal."""
ELSEWHERE = ("campaign", "experiment", "replay", "report")
"""Packages that only read or repeat the refusals of the daemon."""


class Refusal(NamedTuple):
    """One refusal in the source: code, module, and the text if it is written there; ``…`` is a value."""

    code: str
    module: str
    text: str


def refusals() -> list[Refusal]:
    """Return every refusal whose code is a constant in its call."""
    found = {refusal for path in sorted((ROOT / "pcmrs").rglob("*.py")) for refusal in _of_file(path)}
    return sorted(found)


def _of_file(path: Path) -> Iterator[Refusal]:
    place = path.relative_to(ROOT).with_suffix("").parts
    if place[1] in ELSEWHERE:
        return
    module = ".".join(place).removesuffix(".__init__")
    tree = ast.parse(path.read_text())
    for scope in ast.walk(tree):
        if isinstance(scope, ast.FunctionDef | ast.AsyncFunctionDef | ast.Module):
            body = [node for statement in scope.body for node in _own_nodes(statement)]
            texts = [node for node in body if isinstance(node, ast.Assign)]
            for call in body:
                if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id in PLACES:
                    first, second = PLACES[call.func.id]
                    if code := _code(_argument(call, "code", first), module):
                        yield Refusal(code, module, _text(_argument(call, "text", second), texts, call.lineno))


def _own_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the node and its children, except functions, which have their own texts."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return
    yield node
    for child in ast.iter_child_nodes(node):
        yield from _own_nodes(child)


def _argument(call: ast.Call, name: str, position: int) -> ast.expr | None:
    named = [keyword.value for keyword in call.keywords if keyword.arg == name]
    return named[0] if named else call.args[position] if len(call.args) > position else None


def _code(node: ast.expr | None, module: str) -> str:
    value = node.value if isinstance(node, ast.Constant) else None
    if isinstance(node, ast.Name) and node.id.isupper():
        value = getattr(import_module(module), node.id)
    return value if isinstance(value, str) else ""


def _text(node: ast.expr | None, assigned: list[ast.Assign], before: int) -> str:
    if isinstance(node, ast.Name):
        meant = [each for each in assigned if each.lineno < before and ast.unparse(each.targets[0]) == node.id]
        node = meant[-1].value if meant else None
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""
