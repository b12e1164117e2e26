"""Search for a workflow: shipped with PCMRS, in an installed package, or in a file of the user."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path

from pcmrs.errors import ConfigurationError
from pcmrs.installed import entry_points_of

FOLDER = Path(__file__).parent
GROUP = "pcmrs.workflows"
"""Group of entry points. Their values are modules; the blueprint lies beside the module."""


@dataclass(frozen=True, slots=True)
class WorkflowFiles:
    """Files of a workflow. Finding them does not read or run any of them.

    Attributes:
        blueprint: TOML file of the blueprint.
        module: Import name of the Python file beside it; empty if that belongs to no package.
    """

    blueprint: Path
    module: str = ""

    @property
    def code(self) -> Path:
        """Python file with the workflow's own checks and steps; it need not exist."""
        return self.blueprint.with_suffix(".py")


def find_workflow(name: str) -> WorkflowFiles:
    """Return the files of the workflow that a configuration or a user names.

    Args:
        name: Name of a shipped workflow or of an entry point, or a path that ends in ``.toml``.

    Raises:
        ConfigurationError: There is no such workflow, or more than one; the text lists the known ones.
    """
    return _at(Path(name).expanduser()) if name.endswith(".toml") else find_installed(name)


def find_installed(name: str) -> WorkflowFiles:
    """Return the files of a workflow by its name only.

    Names from other machines' files must not be paths, because the code at such a path would be run.

    Args:
        name: Name of a shipped workflow or of an entry point.

    Raises:
        ConfigurationError: There is no such workflow, or more than one; the text lists the known ones.
    """
    found = [files for installed, files in _installed() if installed == name]
    if not found:
        _refuse_incomplete(name)
        names = ", ".join(sorted({installed for installed, _ in _installed()}))
        text = f"There is no workflow {name!r}; there are {names}, or give the path of a .toml file."
        raise ConfigurationError(text, workflow=name)
    if len(found) > 1:
        names = " and ".join(str(files.blueprint) for files in found)
        text = f"More than one workflow is called {name!r}: {names}. Give the path of one of them."
        raise ConfigurationError(text, workflow=name)
    return found[0]


def _refuse_incomplete(name: str) -> None:
    """Raise `ConfigurationError` if a package offers the workflow but lacks the module that it names."""
    for point in (each for each in entry_points_of(GROUP) if each.name == name):
        package = point.dist.name if point.dist is not None else "a package"
        text = f"The workflow {name!r} is installed by {package}, but its module {point.module} is missing: "
        raise ConfigurationError(f"{text}install {package} again, with that module in it.", workflow=name)


def _at(path: Path) -> WorkflowFiles:
    if not path.is_file():
        raise ConfigurationError(f"There is no workflow {path}: no such file.", workflow=str(path))
    return WorkflowFiles(path.absolute())


def _installed() -> Iterator[tuple[str, WorkflowFiles]]:
    for path in FOLDER.glob("*.toml"):
        yield path.stem, WorkflowFiles(path, f"{__package__}.{path.stem}")
    for point in entry_points_of(GROUP):
        spec = _spec_of(point.module)
        if spec is not None and spec.origin is not None:
            yield point.name, WorkflowFiles(Path(spec.origin).with_suffix(".toml"), point.module)


def _spec_of(module: str) -> ModuleSpec | None:
    """Find a module without running it or its packages, unlike `importlib.util.find_spec`."""
    parts, spec, path = module.split("."), None, None
    for depth in range(1, len(parts) + 1):
        found = (finder.find_spec(".".join(parts[:depth]), path, None) for finder in sys.meta_path)
        spec = next((candidate for candidate in found if candidate is not None), None)
        if spec is None:
            return None
        path = spec.submodule_search_locations
    return spec
