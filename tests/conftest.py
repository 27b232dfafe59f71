"""What several tests share."""

from pathlib import Path

import pytest


@pytest.fixture
def shared_data():
    """Real data that lies beside a checkout and is never part of it; a test that needs it is skipped elsewhere."""
    folder = Path(__file__).parents[1].parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the real data are not beside this checkout ({folder.parent.name}/data)")
    return folder


@pytest.fixture
def threads():
    """Sets the number of threads for a test and puts the old number back."""
    from toile import kernels

    before = kernels.threads()
    yield kernels.set_threads
    kernels.set_threads(before)
