"""Fuzz targets: every parser that bytes from outside reach, and for each a small corpus, which the suite replays."""
