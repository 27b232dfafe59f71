"""The page of `toile report RUN`: one row a frame, what is wrong, why, and what to do next, without a truth too."""
