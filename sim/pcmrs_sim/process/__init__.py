"""The simulated cell in a separate process, so that the device node only drives it, as it drives a real cell.

The entry point of the driver is in `driver`. It starts the process (`__main__`) and gives the node its devices
(`client`). The process steps the world, answers calls (`server`), and supervises the node, as a robot's cabinet does.
"""
