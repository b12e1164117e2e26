"""Reports as pages: HTML that needs no script, with every text escaped and nothing left out in silence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

NONE: Final = "–"


def render(package: str, template: str, *filters: Callable[..., Any], **values: Any) -> str:
    """A template with values in it.

    Args:
        package: In whose folder the template lies.
        template: Its name.
        filters: Of the template, by their names.
        values: What it shows; one that it names and does not get is an error.
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
    """A number with so many decimals; a dash where there is none."""
    return NONE if value is None else f"{value:.{digits}f}".replace("-", "−")
