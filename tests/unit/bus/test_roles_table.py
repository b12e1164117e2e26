"""The table of roles in the documentation is the one that the access control is made of."""

from __future__ import annotations

from pcmrs.bus.access import roles_as_markdown
from tests import ROOT


def test_the_documentation_has_the_table_of_roles() -> None:
    assert roles_as_markdown() in (ROOT / "docs" / "access.md").read_text()
