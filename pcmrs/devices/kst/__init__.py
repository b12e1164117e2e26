"""The client side of the KUKA Sunrise Toolbox: framing, numbers, commands, and one connection that streams."""
