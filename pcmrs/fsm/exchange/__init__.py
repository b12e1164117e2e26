"""Workflows for other tools and from them: SCXML, Promela, Mermaid, draw.io, tables, JSON Schema."""

SCXML_NAMESPACE = "http://www.w3.org/2005/07/scxml"
