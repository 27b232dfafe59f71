"""What several tests of the avatar share."""

import pytest


@pytest.fixture(scope="session")
def sample_avatar(sample_run, tmp_path_factory):
    """A layered avatar and its baseline, two steps a phase, frame 3 held out; never written into but by tests of drivers."""
    from toile.avatar.settings import DataSettings, NetworkSettings, preset
    from toile.avatar.train.make import Request, make_avatar

    sizes = dict(
        data=DataSettings(geometry_size=64, texture_size=64, image=(64, 64), pixel_scale=4.0),
        network=NetworkSettings(latent=8, width=8, least_width=4, ao_rays=4, ao_size=32),
        body_steps=2, garment_steps=2, joint_steps=2, baseline_lr=(1.0,),
    )  # fmt: skip
    folder = tmp_path_factory.mktemp("trained") / "avatar"
    make_avatar(
        Request(sample_run, preset("draft").model_copy(update=sizes), say=lambda _: None), folder, baseline=True
    )
    return folder
