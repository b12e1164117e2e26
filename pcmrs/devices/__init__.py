"""Devices: their protocols, their drivers, the nodes that serve them, and the checks between daemon and device."""
