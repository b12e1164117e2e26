"""Public names of a module as Markdown: signature, meaning, arguments and errors, read from the source.

The source is read and not imported, so no extra is needed and annotations stay as they were written.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from inspect import cleandoc
from pathlib import Path
from typing import NamedTuple

from schema_tables import plain

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "api"
"""Pages whose lines ``{{ module NAME EXTRA… }}`` are the list of public modules."""
LONGEST_LINE = 100
"""Longest signature on one line."""
LONGEST_DEFAULT = 40
"""Longest default in a table; a longer one is in the source."""
MODULE = re.compile(r"^\{\{ module ([\w.]+)((?: \w+)*) \}\}$", re.MULTILINE)
"""Place in a page that a module fills: its name, and the extras of which it needs one."""
_SECTION = re.compile(r"^(Args|Attributes|Returns|Yields|Raises):\n((?:    .*\n?|\n)+)", re.MULTILINE)
_ENTRY = re.compile(r"^(\*{0,2}\w+): (.*(?:\n(?:    .*)?)*)", re.MULTILINE)

Function = ast.FunctionDef | ast.AsyncFunctionDef
Definition = Function | ast.ClassDef | ast.Assign | ast.AnnAssign


class Documentation(NamedTuple):
    """Parts of a docstring, each as one line of Markdown.

    Attributes:
        meaning: First paragraph.
        entries: For ``Args``, ``Attributes`` and ``Raises`` the meaning of each name.
        result: Text of ``Returns`` or ``Yields``.
    """

    meaning: str
    entries: Mapping[str, Mapping[str, str]]
    result: str


class PublicName(NamedTuple):
    """A public name with its definition, which may be in a private module.

    Attributes:
        module: Public module from which the name is imported.
        name: The name.
        node: Its definition.
        text: Its docstring, or the string below a constant; empty if there is none.
    """

    module: str
    name: str
    node: Definition
    text: str


def public_modules() -> dict[str, tuple[str, ...]]:
    """Return for each public module the extras of which it needs one; none for the base install."""
    texts = [page.read_text() for page in sorted(PAGES.glob("*.md"))]
    return {name: tuple(extras.split()) for text in texts for name, extras in MODULE.findall(text)}


def names_of(module: str) -> list[str]:
    """Return ``__all__`` of a module; nothing if it has none."""
    for statement in _tree(module).body:
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "__all__":
            names: list[str] = ast.literal_eval(statement.value)
            return names
    return []


def public_names(module: str) -> Iterator[PublicName]:
    """Yield the public names of a module with their definitions.

    Raises:
        LookupError: The module defines or imports no such name.
    """
    for name in names_of(module):
        node, text = _found(module, name)
        yield PublicName(module, name, node, text)


def methods_of(node: ast.ClassDef) -> Iterator[Function]:
    """Yield the public methods and properties of a class, except setters and overloads."""
    for each in node.body:
        if isinstance(each, Function) and not each.name.startswith("_"):
            decorators = " ".join(ast.unparse(decorator) for decorator in each.decorator_list)
            if ".setter" not in decorators and "overload" not in decorators:
                yield each


def arguments_of(node: Function) -> list[str]:
    """Return the names of a function's arguments, except ``self``, ``cls`` and those that are not used."""
    given = node.args
    rest = [each for each in (given.vararg, given.kwarg) if each]
    names = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs, *rest)]
    return [name for name in names if name not in ("self", "cls") and not name.startswith("_")]


def parsed(docstring: str) -> Documentation:
    """Return the parts of a docstring in the Google style."""
    text = cleandoc(docstring)
    sections = {title: cleandoc(f"\n{body}") for title, body in _SECTION.findall(f"{text}\n")}
    entries = {
        title: {name.lstrip("*"): plain(meaning) for name, meaning in _ENTRY.findall(sections.get(title, ""))}
        for title in ("Args", "Attributes", "Raises")
    }
    return Documentation(
        plain(text.partition("\n\n")[0]), entries, plain(sections.get("Returns", sections.get("Yields", "")))
    )


def module_section(module: str, extras: Sequence[str]) -> Iterator[str]:
    """Yield the heading of a module, and its public names.

    Args:
        module: Name of the module.
        extras: Extras of which it needs one.
    """
    yield f"## `{module}` {{ #{module} }}\n"
    needed = f" Needs the extra {' or '.join(f'`{extra}`' for extra in extras)}." if extras else ""
    yield f"{parsed(ast.get_docstring(_tree(module)) or '').meaning}{needed}\n"
    for public in public_names(module):
        yield f"### `{public.name}` {{ #{module}.{public.name} }}\n"
        match public.node:
            case ast.ClassDef():
                yield from _class(public.node)
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                yield from _function(public.node)
            case _:
                yield f"```python\n{_value(public)}\n```\n"
                yield f"{parsed(public.text).meaning}\n"


@cache
def _tree(module: str) -> ast.Module:
    path = ROOT.joinpath(*module.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return ast.parse(file.read_text())


def _found(module: str, name: str) -> tuple[Definition, str]:
    """Return the definition of a name, in this module or in the one that it is imported from, and its text."""
    body = _tree(module).body
    for number, statement in enumerate(body):
        match statement:
            case ast.ClassDef() | ast.FunctionDef() | ast.AsyncFunctionDef() if statement.name == name:
                return statement, ast.get_docstring(statement) or ""
            case ast.Assign(targets=[ast.Name(id=target)]) | ast.AnnAssign(target=ast.Name(id=target)) if (
                target == name
            ):
                match body[number + 1 : number + 2]:
                    case [ast.Expr(value=ast.Constant(value=str(text)))]:
                        return statement, text
                    case _:
                        return statement, ""
            case ast.ImportFrom(module=str(source)):
                for alias in statement.names:
                    if (alias.asname or alias.name) == name:
                        return _found(source, alias.name)
            case _:
                pass
    raise LookupError(f"{module} has no {name}.")


def _class(node: ast.ClassDef) -> Iterator[str]:
    documentation = parsed(ast.get_docstring(node) or "")
    initial = next((each for each in node.body if isinstance(each, Function) and each.name == "__init__"), None)
    bases = ", ".join(ast.unparse(base) for base in node.bases)
    head = f"class {node.name}({bases})" if bases else f"class {node.name}"
    made = f"\n{_signature(node.name, initial, result=False)}" if initial and arguments_of(initial) else ""
    yield f"```python\n{head}{made}\n```\n\n{documentation.meaning}\n"
    yield from _entries(documentation.entries["Args"])
    yield from _fields(node, documentation.entries["Attributes"])
    yield from _ending(documentation)
    for method in methods_of(node):
        if ast.get_docstring(method):  # the others are those of a protocol, which documents them
            yield from _function(method)


def _fields(node: ast.ClassDef, meanings: Mapping[str, str]) -> Iterator[str]:
    """Yield a table of the fields of a class, with the attributes that only its docstring names."""
    declared = {
        each.target.id: each
        for each in node.body
        if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name) and not each.target.id.startswith("_")
    }
    names = dict.fromkeys((*declared, *meanings))
    if names:
        yield "| attribute | type | default | meaning |\n| --- | --- | --- | --- |"
    for name in names:
        field = declared.get(name)
        kind = f"`{ast.unparse(field.annotation)}`" if field else ""
        default = ast.unparse(field.value) if field and field.value else ""
        shown = f"`{default}`" if 0 < len(default) <= LONGEST_DEFAULT else "…" if default else ""
        yield f"| `{name}` | {_cell(kind)} | {_cell(shown)} | {_cell(meanings.get(name, ''))} |"
    yield ""


def _function(node: Function) -> Iterator[str]:
    documentation = parsed(ast.get_docstring(node) or "")
    decorators = [ast.unparse(each) for each in node.decorator_list]
    if any(each.endswith("property") for each in decorators):
        shown = f"{node.name}: {ast.unparse(node.returns) if node.returns else ''}"
    else:
        kept = [
            f"@{each}"
            for each in decorators
            if each in ("classmethod", "staticmethod", "asynccontextmanager", "contextmanager")
        ]
        shown = "\n".join(
            (*kept, f"{'async ' * isinstance(node, ast.AsyncFunctionDef)}def {_signature(node.name, node)}")
        )
    yield f"```python\n{shown}\n```\n\n{documentation.meaning}\n"
    yield from _entries(documentation.entries["Args"])
    yield from _ending(documentation)


def _entries(entries: Mapping[str, str]) -> Iterator[str]:
    yield from (f"- `{name}`: {meaning}" for name, meaning in entries.items())
    yield ""


def _ending(documentation: Documentation) -> Iterator[str]:
    """Yield the result and the errors."""
    if documentation.result:
        yield f"- Returns: {documentation.result}"
    yield from (f"- Raises `{name}`: {meaning}" for name, meaning in documentation.entries["Raises"].items())
    yield ""


def _signature(name: str, node: Function, *, result: bool = True) -> str:
    """Return name, arguments and result as written; with one argument in each line if that would be too long."""
    end = f" -> {ast.unparse(node.returns)}" if result and node.returns else ""
    parts = list(_parts(node.args))
    line = f"{name}({', '.join(parts)}){end}"
    if len(line) <= LONGEST_LINE:
        return line
    return "\n".join([f"{name}(", *(f"    {each}," for each in parts), f"){end}"])


def _parts(given: ast.arguments) -> Iterator[str]:
    """Yield each argument as it is written, except ``self`` and ``cls``, with the marks between them."""
    positional = [*given.posonlyargs, *given.args]
    defaults = [*([None] * (len(positional) - len(given.defaults))), *given.defaults]
    for number, (each, default) in enumerate(zip(positional, defaults, strict=True), start=1):
        if each.arg not in ("self", "cls"):
            yield _part(each, default)
        if number == len(given.posonlyargs):
            yield "/"
    if given.vararg:
        yield f"*{_part(given.vararg, None)}"
    elif given.kwonlyargs:
        yield "*"
    for each, default in zip(given.kwonlyargs, given.kw_defaults, strict=True):
        yield _part(each, default)
    if given.kwarg:
        yield f"**{_part(given.kwarg, None)}"


def _part(argument: ast.arg, default: ast.expr | None) -> str:
    text = ast.unparse(argument)
    if default is None:
        return text
    return f"{text}{' = ' if argument.annotation else '='}{ast.unparse(default)}"


def _value(public: PublicName) -> str:
    text = ast.unparse(public.node)
    return text if len(text) <= LONGEST_LINE else f"{public.name} = ..."


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
