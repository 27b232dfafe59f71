"""A trained avatar with other colours, patterns, pictures or words on its garments."""
