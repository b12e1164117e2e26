"""Events that are recognised in the surgical scene: what a cell does about them."""
