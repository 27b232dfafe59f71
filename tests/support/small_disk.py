"""A disk that takes no large file."""

import resource
from contextlib import contextmanager


@contextmanager
def largest_file(size):
    """While it lasts this process writes no file larger than `size` bytes: an OSError, "File too large"."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
