"""Workflows for other tools: SCXML, Promela, a transition table, and the JSON Schema of a blueprint."""
