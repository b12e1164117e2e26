"""Imports structlog without Rich, which our own processes do not use for their log.

structlog imports Rich for tracebacks with local variables wherever it is installed, and Rich imports its syntax
highlighter. That is a fifth of the imports of a device node. Only modules that start a process of ours import this one,
before any other: a program of a user keeps its structlog as it is.
"""

from __future__ import annotations

import sys

if "structlog" not in sys.modules and "rich" not in sys.modules:
    sys.modules["rich"] = None  # type: ignore[assignment]  # structlog takes it as not installed
    try:
        import structlog  # noqa: F401
    finally:
        del sys.modules["rich"]
