"""Texture alignment: garments slide along their registered surfaces until their prints lie still on them."""
