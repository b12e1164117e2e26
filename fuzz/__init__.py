"""Fuzz targets: every parser of bytes from outside, each with a small corpus that the test suite replays."""
