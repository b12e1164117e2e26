"""All figures of speed: each beside its peer and its budget; written to `RESULTS.md` with machine and date.

A figure is a ratio to its peer in the same run, so that it says the same on another machine: the time of a command to
that of a bare echo, two flushes and a fixed time; events per second to those of the best Python library; or, where
nothing comparable exists, to a fixed aim. A budget (`budgets.toml`) is the ratio that the code is known to keep.
`--check` runs the quick benchmarks, up to three times, and fails for a ratio that was more than 25 % above its budget
in each of the three. A peer that is not installed is named.

    .venv/bin/python benchmarks/bench.py [--check] [--only dispatch fsm ...] [-o benchmarks/RESULTS.md] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
BUDGETS = FOLDER / "budgets.toml"
TOLERANCE, TRIES = 1.25, 3
"""A ratio may be so many times its budget; it fails a check when it is above that in so many runs."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A measured value beside its peer.

    Attributes:
        name: What was measured.
        value: Measured value, in `unit`.
        unit: Its unit.
        peer: What it is compared with.
        base: Value of the peer, in `unit`; None if the peer is not installed.
        faster_is_more: True for rates: the ratio is then `base` / `value`.
    """

    name: str
    value: float
    unit: str
    peer: str
    base: float | None
    faster_is_more: bool = False

    @property
    def ratio(self) -> float | None:
        """Cost relative to the peer: 1 is as fast, 2 is half as fast; None without the peer."""
        if self.base is None:
            return None
        return self.base / self.value if self.faster_is_more else self.value / self.base


def from_command(found: dict[str, Any], where: str) -> Iterator[Figure]:
    """Yield the figures of the whole daemon.

    Args:
        found: Output of `command.py`.
        where: ``disk`` or ``RAM disk``.
    """
    echo, chain = found["echo"]["p50"], found.get("roscpp chain", {}).get("p50")
    flushes = 2 * found["commit"]["p50"] if where == "disk" else 0.0
    name = f"whole daemon, {where}, UDP"
    peer = "echo + two flushes + 500 µs" if where == "disk" else "echo + 500 µs"
    yield Figure(f"{name}, accepted", found["accepted"]["p50"], "µs", peer, echo + flushes + 500.0)
    yield Figure(f"{name}, accepted, p99", found["accepted"]["p99"], "µs", "3 times p50", 3 * found["accepted"]["p50"])
    if where != "disk":
        peer = "2 times the roscpp chain"
        yield Figure(f"{name}, accepted, and ROS", found["accepted"]["p50"], "µs", peer, chain and 2 * chain)


def from_dispatch(found: dict[str, Any]) -> Iterator[Figure]:
    """Yield the figures of the dispatcher alone.

    Args:
        found: Output of `dispatch.py`.
    """
    echo, query = "UDP, bare asyncio echo (uvloop)", "Zenoh, bare query answered in the loop"
    for kind, times in found.items():
        flushes = 2 * times["one SQLite commit with fsync, alone"]["p50"] if kind == "with" else 0.0
        more = "two flushes + " if flushes else ""
        for name, bare, fixed in (("UDP command", echo, 150.0), ("Zenoh query", query, 200.0)):
            value = times[f"{name}, accepted and committed"]["p50"]
            base = times[bare]["p50"] + flushes + fixed
            peer = f"bare + {more}{fixed:.0f} µs"
            yield Figure(f"dispatcher, {kind} fsync, {name}", value, "µs", peer, base)


def from_fsm(found: dict[str, Any]) -> Iterator[Figure]:
    """Yield the figures of the state machine core.

    Args:
        found: Output of `fsm.py`.
    """
    aims = {"sync": ("PCMRS engine", 20.0), "async": ("PCMRS dispatcher, no journal", 5.0)}
    for kind, (ours, times) in aims.items():
        rates = {each["name"]: each["events_per_s"] for each in found[kind]}
        peers = {each["name"]: each["events_per_s"] for each in found[kind] if each["peer"]}
        best = max(peers, key=lambda name: peers[name], default=None)
        peer = f"{times:.0f} times the best Python library ({best or 'none installed'})"
        base = times * peers[best] if best else None
        yield Figure(ours, rates[ours], "events/s", peer, base, faster_is_more=True)


def from_house(found: dict[str, Any]) -> Iterator[Figure]:
    """Yield the length of the route of a command.

    Args:
        found: Output of `house.py`.
    """
    for what, aim in (("calls", 150.0), ("files", 25.0)):
        yield Figure(f"one command: {what}", found[f"{what} on the route of a command"], what, "aim", aim)


def from_rest(found: dict[str, Any]) -> Iterator[Figure]:
    """Yield what a cell at rest takes.

    Args:
        found: Output of `rest.py`.
    """
    yield Figure("cell at rest, processor", found["total"]["percent"], "% of a core", "aim", 10.0)
    yield Figure("cell at rest, memory", found["total"]["pss_mb"], "MB", "aim", 350.0)


def from_start(found: dict[str, Any]) -> Iterator[Figure]:
    """Yield the times of a start and of the command line.

    Args:
        found: Output of `start.py`.
    """
    yield Figure("start to the first answered command", found["answer"], "s", "aim", 2.0)
    for name in ("pcmrs --help", "pcmrs state"):
        yield Figure(name, found[name], "s", "aim", 0.2)


def from_kinematics(found: dict[str, Any]) -> Iterator[Figure]:
    """Yield the times of inverse kinematics.

    Args:
        found: Output of `kinematics.py`.
    """
    for arm, about in found["arms"].items():
        problems = about["problems"]
        yield Figure(
            f"{arm}, random target",
            problems["random targets, alone"]["PCMRS inverse"]["median_ms"],
            "ms",
            "aim",
            0.4,
        )
        for problem, ours in (("random targets", "PCMRS inverse"), ("small steps", "PCMRS track")):
            peers = {name: each["median_ms"] for name, each in problems[problem].items() if name != ours}
            best = min(peers, key=lambda name: peers[name], default=None)
            yield Figure(
                f"{arm}, {problem}",
                problems[problem][ours]["median_ms"],
                "ms",
                f"the fastest other package ({best or 'none installed'})",
                peers[best] if best else None,
            )


def from_archive(found: dict[str, Any]) -> Iterator[Figure]:
    """Yield the rate of archiving and the slowest question.

    Args:
        found: Output of `archive.py`.
    """
    rate = found["add"]["rows"] / found["add"]["seconds"]
    yield Figure("archive", rate, "rows/s", "aim", 50_000.0, faster_is_more=True)
    slowest = max(answer["seconds"] for answer in found["ask"].values())
    yield Figure("slowest question to an archive", slowest, "s", "aim", 2.0)


def from_explore(found: dict[str, Any]) -> Iterator[Figure]:
    """Yield the rate of simulated sessions on one core.

    Args:
        found: Output of `pcmrs faults explore`.
    """
    rate = found["simulated"] / found["cost"]
    yield Figure("simulated sessions", rate, "times real time and core", "aim", 1000.0, faster_is_more=True)


def from_seal(found: dict[str, Any]) -> Iterator[Figure]:
    """Yield the cost of the seal of device messages.

    Args:
        found: Output of `seal.py`.
    """
    for key, times in found.items():
        yield Figure(
            f"seal and check of {key}", times["seal"] + times["check"], "µs", "two bare HMACs", 2 * times["bare HMAC"]
        )


Reader = Callable[[dict[str, Any]], Iterator[Figure]]
PARTS: dict[str, tuple[list[str], Reader]] = {
    "disk": (["command.py", "--count", "200", "--rounds", "5"], lambda found: from_command(found, "disk")),
    "ram": (
        ["command.py", "--count", "200", "--rounds", "5", "--ram"],
        lambda found: from_command(found, "RAM disk"),
    ),
    "dispatch": (["dispatch.py", "--count", "2000"], from_dispatch),
    "fsm": (["fsm.py"], from_fsm),
    "house": (["house.py", "--route"], from_house),
    "seal": (["seal.py", "--count", "50000"], from_seal),
    "start": (["start.py", "--runs", "5"], from_start),
    "rest": (["rest.py"], from_rest),
    "kinematics": (["kinematics.py", "--arms", "iiwa14", "panda", "ur5", "--targets", "1000"], from_kinematics),
    "archive": (["archive.py", "--sessions", "100", "--rows", "10000"], from_archive),
    "explore": (
        ["-m", "pcmrs.cli", "faults", "explore", "--workers", "1", "--sessions", "24", "--seed", "1"],
        from_explore,
    ),
}
"""Parts of a run: the words of their program, and how its output is read."""

CHECKED: dict[str, list[str]] = {
    "dispatch": ["dispatch.py", "--count", "300", "--fsync", "without"],
    "fsm": ["fsm.py", "--rounds", "5", "--events", "200"],
    "house": ["house.py", "--route"],
    "seal": ["seal.py", "--count", "5000"],
}
"""Quick forms of the parts that depend on no disk and on no whole daemon, for `--check`."""


def measured(name: str, words: list[str]) -> list[Figure]:
    """Run a part; return its figures.

    Args:
        name: Name of the part.
        words: Words of its program.

    Raises:
        SystemExit: The program failed.
    """
    program = words if words[0] == "-m" else [str(FOLDER / words[0]), *words[1:]]
    print(f"{name} …", file=sys.stderr, flush=True)
    ran = subprocess.run([sys.executable, *program, "--json"], capture_output=True, text=True, check=False)
    if ran.returncode:
        raise SystemExit(f"{name}: {ran.stderr[-2000:]}")
    return list(PARTS[name][1](json.loads(ran.stdout)))


def budgets() -> dict[str, float]:
    """Return the budget of each figure that has one."""
    return {name: float(ratio) for name, ratio in tomllib.loads(BUDGETS.read_text())["ratio"].items()}


def over(figures: list[Figure]) -> dict[str, str]:
    """Return the figures that are over their budget, each with a description.

    Args:
        figures: Measured figures.
    """
    known = budgets()
    return {
        each.name: f"{each.name}: {each.ratio:.2f} of {each.peer}, budget {known[each.name]:.2f}"
        for each in figures
        if each.ratio is not None and each.name in known and each.ratio > TOLERANCE * known[each.name]
    }


def check() -> int:
    """Measure the quick parts until no figure is over its budget, at most three times; return the exit code."""
    late: set[str] | None = None
    for _ in range(TRIES):
        found: dict[str, str] = {}
        for name, words in CHECKED.items():
            found |= over(measured(name, words))
        late = set(found) if late is None else late & set(found)
        if not late:
            print("every checked figure is within its budget")
            return 0
        print(*found.values(), sep="\n")
    print(f"over budget in {TRIES} of {TRIES} runs: {', '.join(sorted(late or ()))}")
    return 1


def as_markdown(figures: list[Figure]) -> str:
    """Return the page of results.

    Args:
        figures: Measured figures.
    """
    known = budgets()
    lines = [
        "# Results",
        "",
        f"Made by `make bench` on {datetime.now(UTC):%Y-%m-%d}: {os.cpu_count()} cores, {platform.machine()}, "
        f"Python {platform.python_version()}, Linux {platform.release()}. All devices are simulated. A ratio of 1 is "
        "the aim or the peer's figure, and smaller is better; medians, unless a row names another figure.",
        "",
        "| figure | measured | peer or aim | its value | ratio | budget |",
        "| --- | ---: | --- | ---: | ---: | ---: |",
    ]
    for each in figures:
        base = "not installed" if each.base is None else f"{each.base:,.4g} {each.unit}"
        ratio = "" if each.ratio is None else f"{each.ratio:.2f}"
        budget = f"{known[each.name]:.2f}" if each.name in known else ""
        lines.append(f"| {each.name} | {each.value:,.4g} {each.unit} | {each.peer} | {base} | {ratio} | {budget} |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="only compare quick figures with their budgets")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), help="only these parts")
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "RESULTS.md")
    parser.add_argument("--json", action="store_true", help="print JSON, and write no page")
    arguments = parser.parse_args()
    if arguments.check:
        sys.exit(check())
    figures = [figure for name in arguments.only for figure in measured(name, PARTS[name][0])]
    if arguments.json:
        print(json.dumps([asdict(each) | {"ratio": each.ratio} for each in figures]))
        return
    text = as_markdown(figures)
    print(text)
    arguments.output.write_text(text)


if __name__ == "__main__":
    main()
