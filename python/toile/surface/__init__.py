"""Curves, openings and maps on surfaces; what takes a surface to another."""
