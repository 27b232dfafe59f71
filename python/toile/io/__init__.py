"""Files in and out: one file a format or dataset layout; units and axes convert here and nowhere else."""
