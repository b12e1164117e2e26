"""Transcranial magnetic stimulation of the motor cortex: what a pulse evokes, and the intensity that it takes."""
