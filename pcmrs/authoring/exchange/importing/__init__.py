"""State charts of other tools as blueprints: SCXML, Mermaid and draw.io."""
