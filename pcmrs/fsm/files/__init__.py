"""Blueprint files: reading files from any author, and writing files for people."""
