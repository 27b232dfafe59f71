"""Synthetic captures with full truth, from parts that others wrote: anny bodies, newton cloth, open3d scans."""
