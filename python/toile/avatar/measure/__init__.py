"""A trained avatar against pictures it was not trained on, and against the truth: figures, sheets, pages."""
