"""What several tests share."""

import shutil
import time
from pathlib import Path

import pytest

from toile import speech

SLOW = 60  # seconds that a slow test takes which says nothing else


def pytest_addoption(parser):
    text = (
        "start no test that would end later than so many seconds from now, by what its mark says and how much longer "
        "than theirs said those before took; shorter ones first"
    )
    parser.addoption("--time-budget", type=float, metavar="SECONDS", help=text)


def seconds_of(item):
    """How long a test takes on two cores, as its mark `slow(seconds)` says."""
    mark = item.get_closest_marker("slow")
    return 0 if mark is None else mark.kwargs.get("seconds", SLOW)


def pytest_collection_modifyitems(config, items):
    if config.getoption("--time-budget") is not None:
        items.sort(key=seconds_of)
        config.stash[BUDGET] = Budget(config.getoption("--time-budget"))


class Budget:
    """Seconds that are left for tests, on a machine that may be slower than their marks say."""

    def __init__(self, seconds):
        self.deadline, self.said, self.taken = time.monotonic() + seconds, 0.0, 0.0

    @property
    def left(self):
        return self.deadline - time.monotonic()

    def needs(self, item):
        return seconds_of(item) * max(self.taken / max(self.said, 1e-9), 1.0)


BUDGET = pytest.StashKey[Budget]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item, nextitem):
    """Notes how long a slow test takes, what it shares with others included."""
    budget, begun = item.config.stash.get(BUDGET, None), time.monotonic()
    if budget is None or not 0 < budget.needs(item) <= budget.left:
        return (yield)
    found = yield
    budget.said, budget.taken = budget.said + seconds_of(item), budget.taken + time.monotonic() - begun
    return found


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    budget = item.config.stash.get(BUDGET, None)
    if budget is not None and (needs := budget.needs(item)) > budget.left:
        pytest.skip(f"not run: {max(budget.left, 0):.0f} s are left of --time-budget, it takes about {needs:.0f} s")


@pytest.fixture(scope="session")
def shared_data():
    """Real data that lies beside a checkout and is never part of it; a test that needs it is skipped elsewhere."""
    folder = Path(__file__).parents[1].parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the real data are not beside this checkout ({folder.parent.name}/data)")
    return folder


@pytest.fixture(autouse=True)
def in_words():
    """A command that a test calls with --json or --quiet leaves its process speaking so: the next test hears words again."""
    yield
    speech.speak()


@pytest.fixture
def threads():
    """Sets the number of threads for a test and puts the old number back."""
    from toile import kernels

    before = kernels.threads()
    yield kernels.set_threads
    kernels.set_threads(before)


@pytest.fixture(scope="session")
def made_once(tmp_path_factory, request):
    """made_once(name, make): the folder that `make(folder)` makes in the first test process that asks for it; all others share it,
    so nobody writes into it."""
    from toile.io.locks import locked

    alone = not hasattr(request.config, "workerinput")
    base = tmp_path_factory.getbasetemp()
    base = base if alone else base.parent

    def shared(name, make):
        place = base / "shared" / f"of_{name}"
        with locked(place):
            if not (place / "whole").exists():
                shutil.rmtree(place / name, ignore_errors=True)  # half made
                make(place / name)
                (place / "whole").touch()
        return place / name

    return shared


@pytest.fixture(scope="session")
def sample_run(made_once):
    """Four frames of the bundled capture (8 cameras, 360 px), registered as a draft; never written into."""
    from toile.config import preset
    from toile.pipeline.run import register

    def make(run):
        capture = Path(__file__).parents[1] / "data_samples" / "tshirt-talk"
        assert register(capture, run, preset("draft"), (0, 1, 2, 3)).ok == (0, 1, 2, 3)

    return made_once("run", make)


@pytest.fixture(scope="session")
def sample_avatar(sample_run, made_once, tmp_path_factory):
    """A layered avatar and its baseline, two steps a phase, frame 3 held out; never written into but by tests of drivers."""
    from toile.avatar.settings import DataSettings, NetworkSettings, preset
    from toile.avatar.train.make import Request, make_avatar

    sizes = dict(
        data=DataSettings(geometry_size=64, texture_size=64, image=(64, 64), pixel_scale=4.0),
        network=NetworkSettings(latent=8, width=8, least_width=4, ao_rays=4, ao_size=32),
        body_steps=2, garment_steps=2, joint_steps=2, baseline_lr=(1.0,),
    )  # fmt: skip
    asked = Request(sample_run, preset("draft").model_copy(update=sizes), say=lambda _: None)
    made = made_once("trained", lambda folder: make_avatar(asked, folder, baseline=True))
    return shutil.copytree(made, tmp_path_factory.mktemp("trained") / "avatar")


@pytest.fixture(scope="session")
def driven_avatar(sample_avatar, made_once):
    """The same with a temporal model, barely taught; copy it to write into it."""
    from toile.avatar.drive.teaching import train_temporal
    from toile.avatar.settings import TemporalSettings

    def make(folder):
        shutil.copytree(sample_avatar, folder)
        train_temporal(folder, TemporalSettings(window=2, channels=8, steps=20))

    return made_once("with_driver", make)
