"""Diagnosis: what a simulation gets wrong, why, and what naming it gains."""

from identify.diagnosis.verdict import Diagnosis, diagnose

__all__ = ["Diagnosis", "diagnose"]
