"""HTML pages from templates, without scripts; all text is escaped, and a missing value is an error."""

from __future__ import annotations

import base64
import datetime
from collections.abc import Callable
from typing import Any, Final

NONE: Final = "–"
"""Text of a number that is missing."""
PNG, SVG = "image/png", "image/svg+xml"
"""Media types of pictures."""


def render(package: str, template: str, *filters: Callable[..., Any], **values: Any) -> str:
    """Return a rendered template.

    Args:
        package: Package whose folder holds the template.
        template: Name of the template.
        filters: Filters, available in the template by their names.
        values: Values of the template's variables.
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
    """Return a number as text; a dash if it is missing.

    Args:
        value: Number, or None.
        digits: Number of decimals.
    """
    return NONE if value is None else f"{value:.{digits}f}".replace("-", "−")


def embedded(picture: bytes, media_type: str) -> str:
    """Return a picture as a ``data:`` URL.

    Args:
        picture: Content of its file.
        media_type: `PNG` or `SVG`.
    """
    return f"data:{media_type};base64,{base64.b64encode(picture).decode()}"


def utc(wall: float, form: str) -> str:
    """Return a time as text, in UTC.

    Args:
        wall: Unix seconds.
        form: Format, as for `strftime`.
    """
    return datetime.datetime.fromtimestamp(wall, datetime.UTC).strftime(form)
