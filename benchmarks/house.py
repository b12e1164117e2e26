"""Figures of the code itself: its size, its documentation, and the route of one command through it.

    .venv/bin/python benchmarks/house.py [--tree .] [--route] [--json]

Without `--route` nothing is imported, so that `--tree` may be another checkout, of an earlier commit too. With it,
an accepted command (the second half of a plan, over UDP) goes through gateway, dispatcher and journal of this
checkout, and every call of a function of `pcmrs` is counted, from the datagram to the reply, in the loop and in the
journal's thread.
"""

from __future__ import annotations

import argparse
import ast
import asyncio
import io
import json
import sys
import tempfile
import threading
import tokenize
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from types import FrameType
from typing import Any

PRODUCT = "pcmrs"
Function = ast.FunctionDef | ast.AsyncFunctionDef


def sizes(tree: Path) -> dict[str, float]:
    """Return sizes and documentation of the product's modules."""
    sources = [path.read_text() for path in sorted((tree / PRODUCT).rglob("*.py"))]
    lines = [source.count("\n") for source in sources]
    comments = sum(map(_comments, sources))
    functions = [function for source in sources for function in _public(ast.parse(source))]
    with_arguments = [function for function in functions if len(_arguments(function)) >= 2]
    documented = [function for function in with_arguments if "Args:" in (ast.get_docstring(function) or "")]
    return {
        "files": len(sources),
        "files under 40 lines": sum(count < 40 for count in lines),
        "lines": sum(lines),
        "median lines of a file": median(lines),
        "longest file": max(lines),
        "comments per 1,000 lines": round(1000.0 * comments / sum(lines), 1),
        "public functions with two or more arguments": len(with_arguments),
        "of these with documented arguments, %": round(100.0 * len(documented) / len(with_arguments), 1),
    }


def _comments(source: str) -> int:
    """Return the number of comment lines, without those for tools."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    texts = (token.string for token in tokens if token.type == tokenize.COMMENT)
    return sum(not text.startswith(("#!", "# noqa", "# type:", "# fmt:")) for text in texts)


def _public(node: ast.AST) -> Iterator[Function]:
    """Yield functions and methods without an underscore, except overrides, overloads, setters and commands."""
    for child in ast.iter_child_nodes(node):
        if (isinstance(child, ast.ClassDef) and not child.name.startswith("_")) or isinstance(child, ast.If | ast.Try):
            yield from _public(child)
        elif isinstance(child, Function) and not child.name.startswith("_"):
            decorators = " ".join(ast.unparse(each) for each in child.decorator_list)
            if not any(word in decorators for word in ("override", "overload", ".command", "click.", "setter")):
                yield child


def _arguments(function: Function) -> list[str]:
    given = function.args
    named = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return [name for name in named if name not in ("self", "cls")]


class Route:
    """Recorder of calls of the product's functions while it is entered, in this thread and in later ones.

    Args:
        package: Folder of the product.
    """

    def __init__(self, package: Path) -> None:
        self._package = f"{package}/"
        self._calls: list[tuple[str, str]] = []
        self._counting = False
        threading.setprofile(self._note)
        sys.setprofile(self._note)

    def __enter__(self) -> Route:
        self._counting = True
        return self

    def __exit__(self, *_: object) -> None:
        self._counting = False
        threading.setprofile(None)
        sys.setprofile(None)

    def found(self) -> dict[str, int]:
        """Return the numbers of calls, of different functions, and of files."""
        return {
            "calls": len(self._calls),
            "functions": len(set(self._calls)),
            "files": len({file for file, _ in self._calls}),
        }

    def _note(self, frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if self._counting and event == "call" and code.co_filename.startswith(self._package):
            self._calls.append((code.co_filename.removeprefix(self._package), code.co_qualname))


async def route() -> dict[str, int]:
    """Return the route of one accepted command, after some commands that initialize caches."""
    import dispatch

    import pcmrs
    from pcmrs.cli.log import log_to_stderr
    from pcmrs.gateway.grammar import format_command
    from pcmrs.testing.daemon import free_port

    log_to_stderr()
    counted = Route(Path(pcmrs.__file__).parent)
    with tempfile.TemporaryDirectory() as folder:
        async with dispatch.running_server(f"tcp/127.0.0.1:{free_port()}", Path(folder), durable=True) as ports:
            reader = asyncio.Queue[bytes]()

            class Client(asyncio.DatagramProtocol):
                def datagram_received(self, data: bytes, _: Any) -> None:
                    reader.put_nowait(data)

            loop = asyncio.get_running_loop()
            link, _ = await loop.create_datagram_endpoint(Client, remote_addr=("127.0.0.1", ports["planner"]))
            for n in range(20):
                link.sendto(format_command("target_rotxxxxxx", 0.0, 0.0, 0.0, 1.0, client_id=str(2 * n)))
                await reader.get()
                await asyncio.sleep(0.05)  # effects of the earlier command have ended
                if n < 19:
                    link.sendto(format_command("target_tslxxxxxx", 0.0, 0.05, 0.1, client_id=str(2 * n + 1)))
                    await reader.get()
                    await asyncio.sleep(0.05)
            last = format_command("target_tslxxxxxx", 0.0, 0.05, 0.1, client_id="39")
            with counted:
                link.sendto(last)
                answer = await reader.get()
            link.close()
            if b"accepted" not in answer:
                raise SystemExit(f"not accepted: {answer!r}")
    return counted.found()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tree", type=Path, default=Path(__file__).parents[1])
    parser.add_argument("--route", action="store_true")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    found: dict[str, Any] = dict(sizes(arguments.tree))
    if arguments.route:
        found |= {f"{name} on the route of a command": count for name, count in asyncio.run(route()).items()}
    if arguments.json:
        print(json.dumps(found))
    else:
        for name, value in found.items():
            print(f"  {name:<50} {value:>10,}")


if __name__ == "__main__":
    main()
