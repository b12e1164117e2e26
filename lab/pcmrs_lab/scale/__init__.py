"""Seeded tasks on many processors: on this machine or on a Dask cluster, with equal results (docs/scale.md)."""
