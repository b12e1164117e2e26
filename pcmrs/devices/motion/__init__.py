"""References that an arm follows, generated in the process that streams to it; the simulated arm uses the same ones."""
