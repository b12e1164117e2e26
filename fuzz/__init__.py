"""Fuzz targets: every parser that bytes from outside reach, and a small corpus for each, which the test suite replays."""
