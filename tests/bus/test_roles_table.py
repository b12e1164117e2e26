"""The table of roles in the documentation is the one that the access control is made of."""

from __future__ import annotations

from pathlib import Path

from pcmrs.bus.access import roles_as_markdown


def test_the_documentation_has_the_table_of_roles() -> None:
    assert roles_as_markdown() in (Path(__file__).parents[2] / "docs" / "access.md").read_text()
