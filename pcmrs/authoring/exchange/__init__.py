"""Workflows for other tools and from them: SCXML, Promela, Mermaid, draw.io, tables, JSON Schema."""

from __future__ import annotations

import re

SCXML_NAMESPACE = "http://www.w3.org/2005/07/scxml"
PROVENANCE_NAMESPACE = "urn:pcmrs:provenance"
"""Namespace of the element with the provenance of a draft; processors ignore elements of other namespaces."""
HUMP = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
STRANGE = re.compile(r"[^a-z0-9_]")


def plain(raw: str, prefix: str = "") -> str:
    """Return `raw` in the letters that a name may have.

    Args:
        raw: A name.
        prefix: Left out if the name begins with it and a dot, or with it and ``_IS_``.
    """
    inner = raw.removeprefix(f"{prefix}.").removeprefix(f"{prefix}_IS_")
    return STRANGE.sub("_", HUMP.sub("_", inner).lower())


def descriptors(event: str) -> list[str]:
    """Return all descriptors that match an event: itself, and its beginnings up to a dot."""
    tokens = event.split(".")
    return [".".join(tokens[:length]) for length in range(len(tokens), 0, -1)]
