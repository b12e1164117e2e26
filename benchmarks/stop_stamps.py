"""Time stamps of a Stop in the processes of a cell, by code that is loaded into each process before its program.

All processes of one machine share one monotonic clock. Each stamp is one line of JSON in a file that all of them append
to: when a process receives a message of Stop; when the daemon sends the hold of the robot and the node receives it;
when the arm's follower gets the hold, and when it gives the first set point of the brake, in any process. `stamping`
returns the environment of such processes."""

from __future__ import annotations

import functools
import json
import os
import sys
import time
from collections.abc import Callable, Mapping
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any

VARIABLE = "PCMRS_STOP_STAMPS"
FOLLOWER = "pcmrs.devices.motion.follower"
COMMANDS = "/dev/robot/cmd"


def stamping(folder: Path) -> Mapping[str, str]:
    """Return the environment of stamped processes, which their children inherit, with a folder for the stamps."""
    load = "import importlib.util, sys\n"
    load += f"spec = importlib.util.spec_from_file_location('stop_stamps', {__file__!r})\n"
    load += "module = sys.modules['stop_stamps'] = importlib.util.module_from_spec(spec)\n"
    load += "spec.loader.exec_module(module)\nmodule.install()\n"
    (folder / "sitecustomize.py").write_text(load)
    path = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))
    return {VARIABLE: str(folder / "stamps"), "PYTHONPATH": path}


class Stamps:
    """Stamps of one cell, read as they come.

    Args:
        folder: Folder that was given to `stamping`.
    """

    def __init__(self, folder: Path) -> None:
        self._file = folder / "stamps"
        self._read = 0
        self._all: list[dict[str, Any]] = []

    def since(self, begun: float) -> list[dict[str, Any]]:
        """Return the stamps from a time of the machine on, in their order."""
        if self._file.exists():
            with self._file.open("rb") as file:
                file.seek(self._read)
                whole, _, _ = file.read().rpartition(b"\n")
            if whole:
                self._read += len(whole) + 1
                self._all += map(json.loads, whole.splitlines())
        self._all = sorted((each for each in self._all if each["at"] >= begun), key=lambda each: each["at"])
        return self._all


def install() -> None:
    """Stamp this process."""
    descriptor = os.open(os.environ[VARIABLE], os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)

    def stamp(what: str, **more: object) -> None:
        line = json.dumps({"at": time.monotonic(), "what": what, "process": os.getpid(), **more})
        os.write(descriptor, line.encode() + b"\n")

    sys.meta_path.insert(0, _Patching({"zenoh": _patch_bus, FOLLOWER: _patch_follower}, stamp))


Stamp = Callable[..., None]


class _Patching(MetaPathFinder):
    """Loader that patches modules right after they were loaded, so that no process loads more modules than it needs."""

    def __init__(self, patches: Mapping[str, Callable[[Any, Stamp], None]], stamp: Stamp) -> None:
        self._patches, self._stamp = dict(patches), stamp

    def find_spec(self, name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        patch = self._patches.pop(name, None)
        spec = PathFinder.find_spec(name, path, target) if patch is not None else None
        if patch is None or spec is None or spec.loader is None:
            return None
        loader: Loader = spec.loader
        load = loader.exec_module

        def loading(module: Any) -> None:
            load(module)
            patch(module, self._stamp)

        loader.exec_module = loading  # type: ignore[method-assign]
        return spec


def _patch_bus(zenoh: Any, stamp: Stamp) -> None:
    session = zenoh.Session
    get, declare_subscriber, declare_queryable = session.get, session.declare_subscriber, session.declare_queryable

    def asking(self: Any, key: Any, *arguments: Any, **options: Any) -> Any:
        if str(key).endswith(COMMANDS) and _holds(options.get("payload")):
            stamp("hold sent")
        return get(self, key, *arguments, **options)

    def on_message(handler: Any) -> Any:
        def receive(sample: Any) -> None:
            stamp("stop received")
            handler(sample)

        return receive

    def on_request(handler: Any) -> Any:
        def receive(query: Any) -> None:
            if query.payload is not None and _holds(query.payload.to_bytes()):
                stamp("hold received")
            handler(query)

        return receive

    def subscribing(self: Any, key: Any, handler: Any = None, *arguments: Any, **options: Any) -> Any:
        stamped = on_message(handler) if str(key).endswith("/stop/*") else handler
        return declare_subscriber(self, key, stamped, *arguments, **options)

    def serving(self: Any, key: Any, handler: Any = None, *arguments: Any, **options: Any) -> Any:
        stamped = on_message(handler) if str(key).endswith("/stop/*") else handler
        stamped = on_request(handler) if str(key).endswith(COMMANDS) else stamped
        return declare_queryable(self, key, stamped, *arguments, **options)

    session.get, session.declare_subscriber, session.declare_queryable = asking, subscribing, serving


def _holds(payload: Any) -> bool:
    return payload is not None and b"\xa4hold" in bytes(payload)


def _patch_follower(module: Any, stamp: Stamp) -> None:
    follower = module.Follower
    hold, advance = follower.hold, follower.advance

    @functools.wraps(hold)
    def holding(self: Any, *arguments: Any, **options: Any) -> None:
        before = self.reference
        if not before.ended:
            stamp("arm told")
        hold(self, *arguments, **options)
        if not before.ended and self.reference is not before:
            self.stamped_brake = before.position.tolist(), before.velocity.tolist()

    @functools.wraps(advance)
    def advancing(self: Any) -> Any:
        sample = advance(self)
        begun = vars(self).pop("stamped_brake", None)
        if begun is not None:
            stamp("braking", positions=begun[0], velocities=begun[1])
        return sample

    follower.hold, follower.advance = holding, advancing
