"""Drivers of real devices, one file each, found by entry point."""
