"""The teleoperator's side: movements of an input device become set points on the bus. Light: no geometry, no robot."""
