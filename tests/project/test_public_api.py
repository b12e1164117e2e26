"""The pages of the Python API and the code: names, arguments, extras, and what examples and documents import."""

from __future__ import annotations

import ast
import importlib
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from pcmrs.extras import EXTRAS
from tests import ROOT
from tests.project.test_packaging import HIDE, OURS, run_python

sys.path.append(str(ROOT / "docs" / "hooks"))
python_api = importlib.import_module("python_api")
MODULES: dict[str, tuple[str, ...]] = python_api.public_modules()
EXAMPLES = sorted((ROOT / "examples").rglob("*.py"))
PAGES = sorted({ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "deploy").rglob("*.md")})
BLOCK = re.compile(r"^```python.*?\n(.*?)^```", re.MULTILINE | re.DOTALL)


def undocumented(name: str, function: ast.AST, text: str) -> Iterator[str]:
    """Yield the arguments that a docstring does not name, and those that it names and that do not exist.

    Args:
        name: Name of the function.
        function: Its definition.
        text: Its docstring.
    """
    arguments = python_api.arguments_of(function)
    entries = python_api.parsed(text).entries
    yield from (f"{name}: {each} does not exist" for each in entries["Args"] if each not in arguments and each != "_")
    if len(arguments) > 1:
        named = {**entries["Args"], **entries["Attributes"]}
        yield from (f"{name}: {each} is not documented" for each in arguments if each not in named)


def gaps(module: str) -> Iterator[str]:
    """Yield what the docstrings of a module's public names lack."""
    for public in python_api.public_names(module):
        if not public.text:
            yield f"{public.name} has no docstring"
        if isinstance(public.node, ast.ClassDef):
            for each in public.node.body:
                if isinstance(each, ast.FunctionDef) and each.name == "__init__":
                    yield from undocumented(public.name, each, public.text)
            for method in python_api.methods_of(public.node):
                if text := ast.get_docstring(method):  # the others are those of a protocol
                    yield from undocumented(f"{public.name}.{method.name}", method, text)
        elif isinstance(public.node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from undocumented(public.name, public.node, public.text)


def imports(program: str) -> Iterator[tuple[str, str]]:
    """Yield module and name of each import of the product; the name is empty if the module itself is imported."""
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "pcmrs":
            yield from ((node.module or "", alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name.split(".")[0] == "pcmrs")


def is_public(module: str, name: str) -> bool:
    if not name or f"{module}.{name}" in MODULES:
        return (f"{module}.{name}" if name else module) in MODULES
    return module in MODULES and name in python_api.names_of(module)


def programs() -> Iterator[tuple[Path, str]]:
    """Yield the examples, and the blocks of Python in the documents."""
    yield from ((path, path.read_text()) for path in EXAMPLES)
    yield from ((page, block) for page in PAGES for block in BLOCK.findall(page.read_text()))


def including(extra: str) -> set[str]:
    """Return an extra with those that it includes."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    inner = re.findall(r"pcmrs\[([\w,]+)\]", " ".join(project["optional-dependencies"][extra]))
    return {extra}.union(*(including(each) for names in inner for each in names.split(",")))


@pytest.mark.parametrize("module", MODULES)
def test_public_names_exist_and_are_documented(module: str) -> None:
    names = python_api.names_of(module)
    imported = importlib.import_module(module)
    assert names, f"{module} is on a page and has no __all__."
    assert imported.__all__ == names
    assert [name for name in names if not hasattr(imported, name)] == []
    assert imported.__doc__
    assert list(gaps(module)) == []


def test_no_private_module_is_on_a_page() -> None:
    assert [module for module in MODULES if "._" in module] == []


def test_each_public_module_is_on_one_page() -> None:
    found = [
        name for page in (ROOT / "docs" / "api").glob("*.md") for name, _ in python_api.MODULE.findall(page.read_text())
    ]
    assert sorted(found) == sorted(MODULES)


def test_examples_and_documents_import_public_names_only() -> None:
    found = [(path.relative_to(ROOT).as_posix(), *each) for path, text in programs() for each in imports(text)]
    assert {"examples/biopsy/biopsy.py", "docs/testing.md", "docs/new-device.md"} <= {path for path, _, _ in found}
    assert [each for each in found if not is_public(*each[1:])] == []


def test_an_internal_name_is_not_public() -> None:
    assert is_public("pcmrs.client", "Client")
    assert is_public("pcmrs", "client")
    assert is_public("pcmrs.client", "")
    assert not is_public("pcmrs.client", "T")
    assert not is_public("pcmrs.bus", "Bus")
    assert not is_public("pcmrs.bus.seal", "")


def test_a_gap_in_a_docstring_is_found() -> None:
    text = "Move.\n\nArgs:\n    start: Begin, m.\n    speed: Speed, m/s."
    function = ast.parse("def move(start, end): ...").body[0]
    assert list(undocumented("move", function, text)) == ["move: speed does not exist", "move: end is not documented"]


@pytest.mark.parametrize("extra", ["", *sorted({extra for extras in MODULES.values() for extra in extras})])
def test_public_modules_need_only_the_extras_of_their_page(extra: str) -> None:
    present = {module for each in (including(extra) if extra else ()) for module in EXTRAS[each]}
    hidden = {*OURS, *(module for modules in EXTRAS.values() for module in modules)} - present
    imported = [module for module, extras in MODULES.items() if (extra in extras if extra else not extras)]
    done = run_python("\n".join((HIDE.format(hidden=hidden), *(f"import {module}" for module in imported))))
    assert done.returncode == 0, done.stderr


def test_a_module_of_the_base_install_loads_nothing_heavy() -> None:
    base = [module for module, extras in MODULES.items() if not extras]
    heavy = {"matplotlib", "mujoco", "pinocchio", "scipy", "uvloop"}
    done = run_python(
        "\n".join((*(f"import {module}" for module in base), f"import sys; print({heavy} & set(sys.modules))"))
    )
    assert (done.stdout.strip(), done.returncode) == ("set()", 0), done.stderr


def test_constants_and_arguments_are_shown_as_written() -> None:
    shown = "\n".join(python_api.module_section("pcmrs.planner", ("daemon", "report")))
    assert "Needs the extra `daemon` or `report`." in shown
    assert "async def open(host: str = '127.0.0.1', port: int = 8057, signer: Signer | None = None) -> Self" in shown
    assert "- Raises `UnknownOutcomeError`: No verdict came within `timeout`." in shown
    assert "| `translation_error_mm` | `float` |  | Distance from the planned position, mm. |" in shown
