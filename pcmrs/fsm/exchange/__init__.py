"""Workflows for other tools and from them: SCXML, Promela, Mermaid, draw.io, tables, JSON Schema."""
