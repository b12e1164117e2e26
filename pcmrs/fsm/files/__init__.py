"""Blueprint files: reading what anybody may have written, and writing what people will read."""
