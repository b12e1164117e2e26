"""The operating room's view: one page that any browser opens, and a client of the bus like any other."""
