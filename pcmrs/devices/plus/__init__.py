"""OpenIGTLink of PLUS and 3D Slicer: messages, framing, rigid transforms in mm, and tracker frames."""
