"""Shared by the studio's tests: the parts are heavy, so each is made once; skipped where the extra is not installed."""

import numpy as np
import pytest


@pytest.fixture(scope="session")
def body():
    pytest.importorskip("anny")
    from toile.studio.body import make_body

    return make_body("fitted", np.random.default_rng(1))


@pytest.fixture(scope="session")
def shirt():
    pytest.importorskip("newton")
    from toile.studio.garment import newton_shirt

    return newton_shirt()


@pytest.fixture(scope="session")
def cut(body):
    from toile.studio.cut import cut_garment

    return cut_garment("tshirt", body)
