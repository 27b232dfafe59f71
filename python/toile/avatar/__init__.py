"""Layered codec avatars: networks, differentiable rendering and their training on a registered run (needs `toile[avatar]`)."""
