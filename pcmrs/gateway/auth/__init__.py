"""Authentication of signed commands, and protection against replay."""
