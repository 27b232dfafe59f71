"""Poses to codes: what moves the garments of a trained avatar."""
