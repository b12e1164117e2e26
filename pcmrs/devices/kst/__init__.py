"""Client of the KUKA Sunrise Toolbox (KST): framing, number format, commands, and one connection that streams."""
