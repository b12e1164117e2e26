"""Python file beside a blueprint: a workflow's own checks, steps and data."""

from __future__ import annotations

import importlib
import importlib.util
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher.workflow import Settle
from pcmrs.errors import ConfigurationError
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, settle
from pcmrs.workflows.find import WorkflowFiles


@dataclass(frozen=True, slots=True)
class WorkflowCode:
    """Definitions in a workflow's Python file.

    Attributes:
        register: Function that adds payloads, checks and steps to those that all procedures share.
        data: Type of the procedure's data.
        settle: Function that fits the data to a commit.
    """

    register: Callable[[Registry[Cell, PlacementData]], None] = lambda _: None
    data: type[PlacementData] = PlacementData
    settle: Settle[PlacementData] = settle


def load_code(files: WorkflowFiles) -> WorkflowCode:
    """Run the Python file of a workflow, if there is one. It is trusted like any other program of the user.

    Args:
        files: Files of the workflow.

    Raises:
        ConfigurationError: The file cannot be run or lacks a definition; the text names the file and the line.
    """
    if not files.code.is_file():
        return WorkflowCode()
    module = add_source_location(files.code, _import, files)
    register, data = getattr(module, "register", None), getattr(module, "Data", PlacementData)
    if not callable(register):
        raise ConfigurationError(f"{files.code}: defines no function register(registry): add it.", file=str(files.code))
    if not (isinstance(data, type) and issubclass(data, PlacementData)):
        raise ConfigurationError(
            f"{files.code}: Data is not a subclass of PlacementData: make it one.", file=str(files.code)
        )
    settle_function = getattr(module, "settle", settle)
    if not callable(settle_function):
        text = f"{files.code}: settle is not a function settle(data, states, effects): make it one."
        raise ConfigurationError(text, file=str(files.code))
    return WorkflowCode(register, data, settle_function)


def add_source_location(file: Path, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function of the user's file, and add the file and the line to any error.

    Args:
        file: File that defines the function.
        function: Function to call.
        *arguments: Arguments of the function.

    Raises:
        ConfigurationError: The function raises an error; the text names the file, the line in it, and the error.
    """
    try:
        return function(*arguments)
    except (Exception, SystemExit) as error:
        line = _line_in(file, error)
        where = f"{file}, line {line}" if line else str(file)
        text = f"{where}: {type(error).__name__}: {error}"
        raise ConfigurationError(text, file=str(file), line=line) from error


def _import(files: WorkflowFiles) -> ModuleType:
    if files.module:
        return importlib.import_module(files.module)
    name = f"pcmrs_workflow_{files.code.stem}"
    spec = importlib.util.spec_from_file_location(name, files.code)
    if spec is None or spec.loader is None:
        raise ImportError(f"{files.code} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses and msgspec look up the module of a class there
    spec.loader.exec_module(module)
    return module


def _line_in(file: Path, error: BaseException) -> int:
    """Return the innermost line of the file that led to the error; 0 if there is none."""
    if isinstance(error, SyntaxError) and error.filename == str(file):
        return error.lineno or 0
    frames: Sequence[traceback.FrameSummary] = traceback.extract_tb(error.__traceback__)
    return next((frame.lineno or 0 for frame in reversed(frames) if frame.filename == str(file)), 0)
