"""The parts of a nightly run: what each runs, and which tests are in it."""

from __future__ import annotations

import shlex
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import msgspec

from tests import ROOT
from tests.support.skip_budget import OPTION

TABLE = Path(__file__).with_name("parts.toml")

Counted = Literal["pytest", "faults", "explore", "mutants", "map", "uncovered", "exit"]


class Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What can be run and resumed by itself.

    Attributes:
        name: Unique. ``make nightly PART=faults`` runs ``faults`` and all that begin with ``faults-``.
        minutes: Expected duration on two cores.
        tests: Files or folders below ``tests`` for pytest; empty for any other command.
        marker: Expression that selects tests of them.
        jobs: Processes of pytest.
        command: For a shell, in the project's folder; ``{commit}`` is a number made from the commit, for seeds.
        counted: How results are counted: from pytest's report, from the JSON that the command prints, or from its
            exit code alone.
        pieces: The part is cut into so many; ``{piece}`` in the command becomes ``1/3``.
        makes: File that the parts of the same first word need, in the project's folder.
    """

    name: str
    minutes: float
    tests: tuple[str, ...] = ()
    marker: str = "nightly"
    jobs: int = 1
    command: str = ""
    counted: Counted = "exit"
    pieces: int = 1
    makes: str = ""

    @property
    def is_made(self) -> bool:
        """Whether the file that it makes is there; true if it makes none."""
        return (ROOT / self.makes).exists()


def parts() -> list[Part]:
    """All parts, in the order in which they are run; one that is cut is as many as it has pieces."""
    table = tomllib.loads(TABLE.read_text())["part"]
    return [piece for each in table for piece in _cut(msgspec.convert(each, Part))]


def chosen(name: str) -> list[Part]:
    """The part of that name, or those whose names begin with it and a hyphen; all for an empty name."""
    return [part for part in parts() if not name or part.name == name or part.name.startswith(f"{name}-")]


def separate() -> list[str]:
    """Names of parts, or first words of parts that share a file, each of which can be run on a separate machine."""
    sharing = {part.name.partition("-")[0] for part in parts() if part.makes}
    first_words = ((part.name.partition("-")[0], part.name) for part in parts())
    return list(dict.fromkeys(first if first in sharing else name for first, name in first_words))


def command_of(part: Part, results: Path, seed: int) -> list[str]:
    """Words of the command line; pytest writes its report to `results`."""
    python = shlex.quote(sys.executable)
    if part.tests:
        files = " ".join(f"tests/{each}" for each in part.tests)
        jobs = f"-n {part.jobs}" if part.jobs > 1 else ""
        options = f"-m '{part.marker}' {OPTION} --hypothesis-profile=nightly {jobs} -q"
        options += f" --junitxml={shlex.quote(str(results))}"
        line = f"{python} -m pytest {options} {files}"
    else:
        bin_folder = Path(sys.executable).parent
        line = part.command.format(python=python, pcmrs=shlex.quote(str(bin_folder / "pcmrs")), commit=seed)
    return ["bash", "-euo", "pipefail", "-c", line]


def holders(test: str, table: Mapping[str, Part] | None = None) -> list[str]:
    """Names of the parts in which a test marked nightly is run.

    Args:
        test: Its file, below ``tests``.
        table: Parts by name; those of the table by default.
    """
    known = table if table is not None else {part.name: part for part in parts()}
    return [
        name
        for name, part in known.items()
        if "nightly" in part.marker and any(test == path or test.startswith(f"{path}/") for path in part.tests)
    ]


def _cut(part: Part) -> list[Part]:
    if part.pieces == 1:
        return [part]
    return [
        msgspec.structs.replace(
            part,
            name=f"{part.name}-{number}",
            command=part.command.replace("{piece}", f"{number}/{part.pieces}"),
            pieces=1,
        )
        for number in range(1, part.pieces + 1)
    ]
