"""`toile doctor`: what of this machine and installation matters, and every kernel against a reference."""
