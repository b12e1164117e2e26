"""Transcranial magnetic stimulation of the motor cortex: evoked potentials, motor threshold and hot-spot."""
