"""Reports as HTML pages without scripts; every text is escaped, and a missing value is an error."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

NONE: Final = "–"
"""Text of a missing number."""


def render(package: str, template: str, *filters: Callable[..., Any], **values: Any) -> str:
    """Render a template.

    Args:
        package: Package whose folder holds the template.
        template: Name of the template.
        *filters: Filters of the template, under their own names.
        **values: Values of the template; one that is used but not given is an error.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(package, "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {function.__name__: function for function in filters}
    return environment.get_template(template).render(values)


def fixed(value: float | None, digits: int = 2) -> str:
    """Format a number with a fixed number of decimals.

    Args:
        value: The number; None gives a dash.
        digits: Number of decimals.
    """
    return NONE if value is None else f"{value:.{digits}f}".replace("-", "−")
