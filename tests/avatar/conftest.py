"""What several tests of the avatar share."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def sample_run(tmp_path_factory):
    """Four frames of the bundled capture (8 cameras, 360 px), registered as a draft; never written into."""
    from toile.config import preset
    from toile.pipeline import register

    run = tmp_path_factory.mktemp("registered") / "run"
    outcome = register(Path(__file__).parents[2] / "data_samples" / "tshirt-talk", run, preset("draft"), (0, 1, 2, 3))
    assert outcome.ok == (0, 1, 2, 3)
    return run
