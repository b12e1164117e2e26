"""The fault campaign: every fault of the catalogue is injected into a real cell, and its response is checked."""
