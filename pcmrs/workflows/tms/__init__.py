"""Stimulation: an armed stimulator, pulses at their planned pose only, and the evoked responses."""
