"""What recorded placements and pose logs say about accuracy."""
