"""Segmenters: from a picture to the label of each pixel of one person, and how sure that is."""
