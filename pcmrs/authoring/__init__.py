"""Design of workflows: from step tables, other notations and drawings; and trying them out."""
