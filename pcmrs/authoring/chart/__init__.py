"""State charts of a workflow: one picture as SVG and PNG, and the same chart as Graphviz and Mermaid text.

Branches stand side by side, a level N+1 branch inside the frame of the level N branch that it refines.
"""

from pcmrs.authoring.chart._dot import dot
from pcmrs.authoring.chart._mermaid import mermaid
from pcmrs.authoring.chart._png import png
from pcmrs.authoring.chart.svg import svg

__all__ = ["dot", "mermaid", "png", "svg"]
