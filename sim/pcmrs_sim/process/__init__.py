"""The simulated cell in a process of its own, so that the device node does nothing but drive it, as a real cell.

`driver` is what the entry point names: it starts the process (`__main__`) and gives the node its devices (`client`).
The process steps the world, answers calls (`server`), and watches that the node is there, as a robot's cabinet does.
"""
