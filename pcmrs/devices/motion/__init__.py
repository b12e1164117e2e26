"""References that an arm follows, generated where the arm is streamed to; the simulated arm follows the same ones."""
