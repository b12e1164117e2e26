"""Imports structlog without Rich, which our own processes do not use for their log.

structlog imports Rich for tracebacks with local variables wherever it is installed, and Rich imports its syntax
highlighter. That is a fifth of the imports of a device node. Only modules that start a process of ours import this one,
before any other that imports structlog: a program of a user keeps its structlog as it is.
"""

from __future__ import annotations

import sys

if "structlog" not in sys.modules and "rich" not in sys.modules:
    sys.modules["rich"] = None  # type: ignore[assignment]  # structlog takes it as not installed
    try:
        import structlog
    finally:
        del sys.modules["rich"]
else:
    import structlog

__all__ = ["structlog"]
