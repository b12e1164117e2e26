"""Program of the product without some of its guards: input that a guard refuses has its effect there.

    python -m pcmrs_lab.campaign.without_guard GUARDS python -m pcmrs.cli serve ...

This is the control of rows whose fault is hostile or wrong input. It shows that the input is refused by the guard, and
not for another reason. A guard is a text in the source of a module, which is compiled with another text in its place.
No file changes, and the product has no setting for it. Child processes that the program forks are changed, too.
"""

from __future__ import annotations

import runpy
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.resources import files
from types import CodeType, ModuleType

PROGRAM = "pcmrs_lab.campaign.without_guard"


@dataclass(frozen=True, slots=True)
class Guard:
    """Guard of the product that a control takes out.

    Attributes:
        module: Name of its module.
        guard: Text of the guard, which occurs once in the source of the module.
        without: Text that takes its place.
    """

    module: str
    guard: str
    without: str


@cache
def guards() -> Mapping[str, Guard]:
    """Return all guards that a control can take out, by name."""
    table = tomllib.loads(files("pcmrs_lab.campaign").joinpath("guards.toml").read_text(encoding="utf-8"))
    return {name: Guard(**entry) for name, entry in table.items()}


def without_guards(*names: str) -> tuple[str, ...]:
    """Return the words before a command line of Python that take guards out of the program.

    Args:
        names: Names of guards.

    Raises:
        KeyError: There is no such guard.
    """
    if unknown := set(names) - guards().keys():
        raise KeyError(*sorted(unknown))
    return sys.executable, "-m", PROGRAM, ",".join(names)


class Finder(MetaPathFinder):
    """Loader of the modules of the guards from their changed source.

    Args:
        changes: Guards to take out.
    """

    def __init__(self, changes: Sequence[Guard]) -> None:
        self._changes = changes

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of a module that has a guard; None for other modules."""
        changes = [each for each in self._changes if each.module == fullname]
        if not changes:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is None or spec.origin is None:
            raise ImportError(f"{fullname}, which has the guard {changes[0].guard!r}, is not found.", name=fullname)
        spec.loader = _ChangedSource(fullname, spec.origin, changes)
        return spec


class _ChangedSource(SourceFileLoader):
    def __init__(self, fullname: str, path: str, changes: Sequence[Guard]) -> None:
        super().__init__(fullname, path)
        self._changes = changes

    def get_code(self, fullname: str) -> CodeType:
        """Return the code of the changed source; the bytecode in the cache is that of the unchanged one."""
        path = self.get_filename(fullname)
        source = self.get_data(path).decode("utf-8")
        for each in self._changes:
            source = changed(source, each)
        return compile(source, path, "exec", dont_inherit=True)


def changed(source: str, guard: Guard) -> str:
    """Return the source of a module without a guard.

    Args:
        source: Source of the module.
        guard: Guard to take out.

    Raises:
        ImportError: The text of the guard does not occur exactly once.
    """
    count = source.count(guard.guard)
    if count != 1:
        text = f"{guard.guard!r} occurs {count} times in {guard.module}; it must occur once: correct guards.toml."
        raise ImportError(text, name=guard.module)
    return source.replace(guard.guard, guard.without)


def main(words: Sequence[str]) -> None:
    """Run the command line after the names of the guards without these guards."""
    changes, module = [guards()[name] for name in words[0].split(",")], words.index("-m")
    early = [each.module for each in changes if each.module in sys.modules]
    if early:
        raise ImportError(f"{early[0]} is loaded already, so its guard cannot be taken out.", name=early[0])
    sys.meta_path.insert(0, Finder(changes))
    sys.argv = ["pcmrs", *words[module + 2 :]]
    runpy.run_module(words[module + 1], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main(sys.argv[1:])
