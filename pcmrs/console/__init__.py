"""The operating room's view: one page for any browser, served by a client of the bus."""
