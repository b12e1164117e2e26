"""Functions that tasks call, by name, with arguments and results as bytes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, Generic, TypeVar, get_args, get_type_hints

import msgspec

T = TypeVar("T", bound=msgspec.Struct)
R = TypeVar("R")

_encoder = msgspec.msgpack.Encoder()
"""MessagePack and not JSON, which has neither infinity nor nan."""


class TaskFunction(Generic[T, R]):
    """Function of a module that takes a list of tasks, and returns the list of their results.

    Args:
        function: The function; its annotations name the types of task and result.

    Attributes:
        name: Its name, ``module:function``.
    """

    def __init__(self, function: Callable[[list[T]], list[R]]) -> None:
        self.name = f"{function.__module__}:{function.__qualname__}"
        self._function = function
        hints = get_type_hints(function)
        self._task: type[T] = get_args(hints["tasks"])[0]
        self._results: msgspec.msgpack.Decoder[R] = msgspec.msgpack.Decoder(get_args(hints["return"])[0])

    @classmethod
    def of(cls, name: str) -> TaskFunction[Any, Any]:
        """Return the function of a name.

        Args:
            name: ``module:function``.
        """
        module, _, function = name.partition(":")
        return cls(getattr(import_module(module), function))

    def call(self, tasks: Sequence[bytes]) -> list[bytes]:
        """Call the function, and return its results in the order of the tasks.

        Args:
            tasks: Tasks, as `encode` writes them.
        """
        given = [msgspec.json.decode(task, type=self._task) for task in tasks]
        return [_encoder.encode(result) for result in self._function(given)]

    @staticmethod
    def encode(task: msgspec.Struct) -> bytes:
        """Return a task as JSON, which identifies it in a file, too."""
        return msgspec.json.encode(task)

    def decode(self, result: bytes) -> R:
        """Return a result from its bytes."""
        return self._results.decode(result)
