"""The teleoperator's side: what hands do at a device becomes set points on the bus. Light: no geometry, no robot."""
