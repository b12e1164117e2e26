"""Code inside a process whose transport is delayed: every frame is matched with the rules of `delays` first."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import zenoh

from pcmrs import failpoints
from pcmrs_lab.campaign.delays import VARIABLE, Delayed, Place, Rule


class Transport:
    """Transport that delays the frames of this process by the rules of a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = threading.Lock()
        self._version: tuple[int, int] | None = None
        self._left: dict[Rule, int] = {}
        self._passed: Counter[tuple[Place, str]] = Counter()

    def rule(self, place: Place, key: str, payload: bytes) -> Rule | None:
        """Return the rule that delays this frame, or None; a frame without a rule is counted as passed.

        Args:
            place: Point at which the frame passes.
            key: Zenoh key of the frame, or name of a failpoint.
            payload: Bytes of the frame.
        """
        with self._lock:
            self._read()
            for rule, left in self._left.items():
                if left and rule.place == place and key.endswith(rule.key) and rule.word.encode() in payload:
                    self._left[rule] -= 1
                    return rule
            self._passed[place, key] += 1
        return None

    def wait(self, rule: Rule, key: str) -> None:
        """Wait in the calling thread for the time of a rule, and record the delay.

        Args:
            rule: Rule that delays the frame.
            key: Zenoh key of the frame, or name of a failpoint.
        """
        before, started = self._passed[rule.place, key], time.monotonic()
        self._append("begun", rule)
        time.sleep(rule.seconds)
        overtaken = self._passed[rule.place, key] - before
        self._append("done", Delayed(rule, started, time.monotonic(), overtaken))

    def delay_in_thread(self, rule: Rule, key: str, go_on: Callable[[], object]) -> None:
        """Continue in a separate thread after the delay of a rule.

        Args:
            rule: Rule that delays the frame.
            key: Zenoh key of the frame.
            go_on: Called after the delay.
        """

        def work() -> None:
            self.wait(rule, key)
            go_on()

        threading.Thread(target=work, daemon=True).start()

    def _read(self) -> None:
        file = self._folder / "rules"
        found = file.stat()
        version = (found.st_ino, found.st_mtime_ns)
        if version != self._version:
            self._version = version
            rules = msgspec.json.decode(file.read_bytes(), type=list[Rule])
            self._left = {rule: self._left.get(rule, rule.times) for rule in rules}

    def _append(self, name: str, what: Rule | Delayed) -> None:
        with (self._folder / name).open("ab", buffering=0) as file:
            file.write(msgspec.json.encode(what) + b"\n")


def install() -> None:
    """Delay this process. Call it before the program starts."""
    transport = Transport(Path(os.environ[VARIABLE]))
    _delay_requests(transport)
    _delay_answers(transport)
    for publisher in (zenoh.Publisher, zenoh.ext.AdvancedPublisher):
        _delay_messages(transport, publisher)
    _delay_failpoints(transport)


def _delay_requests(transport: Transport) -> None:
    get, declare = zenoh.Session.get, zenoh.Session.declare_queryable

    def sending(session: Any, key: Any, *arguments: Any, **options: Any) -> Any:
        rule = transport.rule("send", str(key), bytes(options.get("payload") or b""))
        if rule is not None:
            transport.wait(rule, str(key))
        return get(session, key, *arguments, **options)

    def declaring(session: Any, key: Any, receive: Any, *arguments: Any, **options: Any) -> Any:
        def received(query: Any) -> None:
            payload = b"" if query.payload is None else query.payload.to_bytes()
            rule = transport.rule("receive", str(query.key_expr), payload)
            if rule is None:
                receive(query)
            else:
                transport.delay_in_thread(rule, str(query.key_expr), lambda: receive(query))

        return declare(session, key, received if callable(receive) else receive, *arguments, **options)

    _replace(zenoh.Session, get=sending, declare_queryable=declaring)


def _delay_answers(transport: Transport) -> None:
    reply = zenoh.Query.reply

    def replying(query: Any, key: Any, payload: Any, *arguments: Any, **options: Any) -> None:
        rule = transport.rule("answer", str(key), b"" if query.payload is None else query.payload.to_bytes())
        if rule is not None:
            transport.wait(rule, str(key))
        reply(query, key, payload, *arguments, **options)

    _replace(zenoh.Query, reply=replying)


def _delay_messages(transport: Transport, kind: Any) -> None:
    put = kind.put

    def putting(publisher: Any, payload: Any, *arguments: Any, **options: Any) -> None:
        key = str(publisher.key_expr)
        rule = transport.rule("publish", key, bytes(payload))
        if rule is None:
            put(publisher, payload, *arguments, **options)
        else:
            transport.delay_in_thread(rule, key, lambda: put(publisher, payload, *arguments, **options))

    _replace(kind, put=putting)


def _delay_failpoints(transport: Transport) -> None:
    passing = failpoints.failpoint

    def passed(name: str) -> None:
        rule = transport.rule("pass", name, b"")
        if rule is not None:
            transport.wait(rule, name)
        passing(name)

    # Modules that were imported before refer to the function by their own global name.
    for module in [module for module in sys.modules.values() if getattr(module, "failpoint", None) is passing]:
        _replace(module, failpoint=passed)


def _replace(owner: Any, **functions: Callable[..., Any]) -> None:
    for name, function in functions.items():
        setattr(owner, name, function)
