"""Problems with truth, scores, peers, and the trade of time against error. Run from the project's root."""
