"""What differs in behaviour between two workflows."""
