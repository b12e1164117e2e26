"""Readers for files of other software, which convert everything to RAS and m."""
