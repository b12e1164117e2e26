"""Fuzz targets, run by hand with atheris: every parser of bytes that come from outside."""
