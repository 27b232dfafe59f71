"""Runs measured, and the pages that show it."""
