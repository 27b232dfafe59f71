"""The stages: pure functions over the types of `toile.scene`; none imports another."""
