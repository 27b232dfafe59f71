"""The order of the stages, and what makes a run of them."""


def __getattr__(name):
    """`from toile.pipeline import register`, as it was; gone with the next release."""
    if name not in ("register", "Outcome"):
        raise AttributeError(f"module 'toile.pipeline' has no attribute '{name}'")
    import warnings

    from . import run

    warnings.warn(f"toile.pipeline.{name}: use toile.{name}", DeprecationWarning, stacklevel=2)
    return getattr(run, name)
