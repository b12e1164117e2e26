"""OpenIGTLink for stock 3D Slicer: poses, state and status out; the target and the landmarks in. No motion."""
