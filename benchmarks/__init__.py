"""Measured numbers: `make bench`."""
