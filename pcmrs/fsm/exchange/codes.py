"""Kinds of findings that an import may have, besides those on names in `pcmrs.fsm.names`."""

from __future__ import annotations

CODES = {
    "too_large": "A file or a chart is larger than what is read.",
    "too_deep": "A file is nested deeper than what is read.",
    "not_utf8": "A text file is not in UTF-8.",
    "not_xml": "A file is not well-formed XML.",
    "not_scxml": "An XML file is not SCXML.",
    "not_drawio": "An XML file is not a draw.io diagram, or its compressed part cannot be read.",
    "not_mermaid": "A line is not part of a Mermaid state diagram.",
    "not_supported": "Something that a blueprint cannot express; PCMRS names it rather than guess.",
    "no_states": "A chart has no states.",
    "no_start": "A drawing does not say where it starts.",
    "bad_name": "A name cannot be made into one of a blueprint.",
    "reserved_name": "A name would be a word of Python or PCMRS.",
    "name_collision": "Two names would be the same in a blueprint.",
    "unknown_state": "A transition goes to a state that does not exist.",
}
