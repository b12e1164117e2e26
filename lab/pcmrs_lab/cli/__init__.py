"""Commands of the laboratory, which `pcmrs` finds through the entry-point group `pcmrs.commands`."""
