"""A chart of two states, and the commands that take it."""

from __future__ import annotations

from click.testing import CliRunner, Result

from pcmrs.cli import main

RING = """<scxml xmlns="http://www.w3.org/2005/07/scxml" version="1.0" name="ring">
  <state id="a"><transition event="go" target="b"/></state>
  <state id="b"><transition event="go" target="a"/></state>
</scxml>
"""


def run(*words: str, given: str | bytes | None = None) -> Result:
    return CliRunner().invoke(main, ["fsm", *words], input=given)
