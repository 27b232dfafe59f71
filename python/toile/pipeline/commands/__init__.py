"""The commands that read a capture and make a run of it."""
