"""`toile view`: a page on this machine's loopback that shows a run, an animation or a capture over time."""
