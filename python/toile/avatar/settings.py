"""Settings of an avatar and its training: every default stands here once; presets and command line fill the same objects."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ..config import QUALITIES, Settings
from ..errors import UserError


class DataSettings(Settings):
    """What is read and unwrapped of a run and its pictures."""

    geometry_size: int = 128  # texels along a side of the position maps
    texture_size: int = 512
    modes: int = 64  # principal modes of a garment's unposed shape, the first numbers of its code
    image: tuple[int, int] = (512, 512)  # (height, width) of the crop [px]
    pixel_scale: float = 1.0  # pixels of the capture along one of the crop's, at least
    crop: Literal["person", "garment"] = "person"  # what the crop is centred on
    window: int = Field(
        0, ge=0
    )  # > 0: garments are regressed from so many poses, the frame's own the last; they have no code


class NetworkSettings(Settings):
    """Sizes of the networks."""

    latent: int = 64  # of each garment's code, besides its modes
    width: int = 64  # channels of the widest decoder block; halved with each doubling of the resolution
    least_width: int = 8  # channels of the finest block
    shadow_width: int = 4
    texture_step: int = 1  # texels of the mean texture along one of those that networks read and decode
    ao_rays: int = 64  # of ambient occlusion, per vertex
    ao_size: int = 64  # texels along a side of the shadow network's maps
    view: bool = True  # textures depend on where they are seen from, if the scene has several cameras
    shadow: bool = True  # quasi-shadows from ambient occlusion


class LossWeights(Settings):
    """Weights of METHOD's terms: E_body and E_cloth train the layers apart, E_inv together."""

    geometry: float = 1.0  # of an error of 1 cm^2
    laplacian: float = 10.0  # of 1 cm^2
    texture: float = 30.0  # of a squared error of 1 in a colour of 0..1
    kl: float = 1e-5  # of 1 nat
    image: float = 10.0  # of an error of 1 in a colour of 0..1
    mask: float = 10.0
    visibility: float = 1.0  # 0: layers are not drawn apart either
    impute: float = 0.1  # of 1 cm^2; the baseline only: what the pose decides, decoded from another latent


class Phase(Settings):
    """A stretch of training: the layers of these kinds are optimised by these terms."""

    name: str
    kinds: tuple[Literal["body", "garment", "surface"], ...]
    terms: tuple[str, ...]  # fields of LossWeights
    steps: int = Field(ge=0)
    batch: int = Field(ge=1)  # (frame, camera) samples a step on each device
    lr: float = Field(gt=0)


APART = ("geometry", "laplacian", "texture", "kl")
TOGETHER = ("image", "mask", "visibility", "geometry", "laplacian", "kl")  # geometry: codes of unseen frames stay true


class AvatarSettings(Settings):
    """All settings of a training, as AVATAR/avatar.json keeps them."""

    quality: str = "standard"
    data: DataSettings = DataSettings()
    network: NetworkSettings = NetworkSettings()
    weights: LossWeights = LossWeights()
    body_steps: int = 2000
    garment_steps: int = 2000
    joint_steps: int = 6000
    fit_crop: bool = True  # pictures are scaled down until the crop holds what it is centred on, in every frame
    batch: int = 4
    joint_batch: int = 2
    lr: float = 1e-4  # AdamW
    joint_rate: float = 0.5  # of lr, in inverse rendering, whose image and mask terms a larger step makes diverge
    colour_lr: float = 1e-3  # of gain and bias of the cameras
    decay: float = 0.1  # of the learning rate over a phase: a half cosine to this share
    warm_up: float = 0.1  # share of a phase with a rising learning rate
    clip: float = 1.0  # largest norm of the gradient
    visibility_c: tuple[float, float] = (0.020, 0.005)  # c of the soft visibility, first and last [m]
    checkpoint_every: int = 250  # steps
    picture_every: int = 250  # steps
    diverged: float = 10.0  # a loss beyond this multiple of its recent mean has diverged
    recent: int = 32  # steps of that mean
    returns: int = 5  # to the last good checkpoint, each with half the learning rate, before giving up
    baseline_lr: tuple[float, ...] = (0.5, 1.0, 2.0)  # multiples of lr that the baseline's search tries
    baseline_modes: int = (
        0  # of its surface; a code drawn at random, as it is driven by, would bend the body along them
    )
    baseline_search: float = 0.05  # share of the steps that each of them gets
    seed: int = 0

    def phases(self, layered=True):
        """METHOD's order. The baseline's one surface gets the steps of both layers apart, then the same together."""
        apart, together = dict(batch=self.batch, lr=self.lr), dict(batch=self.joint_batch, lr=self.lr * self.joint_rate)
        if layered:
            yield Phase(name="body", kinds=("body",), terms=APART[:-1], steps=self.body_steps, **apart)
            yield Phase(name="garment", kinds=("garment",), terms=APART, steps=self.garment_steps, **apart)
            yield Phase(name="joint", kinds=("body", "garment"), terms=TOGETHER, steps=self.joint_steps, **together)
        else:
            steps = self.body_steps + self.garment_steps
            yield Phase(name="surface", kinds=("surface",), terms=(*APART, "impute"), steps=steps, **apart)
            yield Phase(
                name="joint", kinds=("surface",), terms=(*TOGETHER, "impute"), steps=self.joint_steps, **together
            )


class TemporalSettings(Settings):
    """The model that gives garments' codes from poses, and its training."""

    model: Literal["window", "damped"] = "window"
    window: int = Field(15, ge=1)  # poses that the window model sees, the current one included
    channels: int = 256
    steps: int = Field(1000, ge=1)  # at most: frames left out say when to stop
    batch: int = 64  # windows, or stretches of the damped model
    stretch: int = 60  # frames that the damped model is unrolled over
    lr: float = 5e-4
    weight_decay: float = 0.01
    seed: int = 0


def preset(quality):
    """The settings of a quality preset: sizes of the maps, widths, steps."""
    if quality not in QUALITIES:
        raise UserError(f"--quality {quality}: expected one of {', '.join(QUALITIES)}")
    if quality == "draft":
        return AvatarSettings(
            quality=quality,
            data=DataSettings(geometry_size=64, texture_size=256, modes=32, image=(256, 256)),
            network=NetworkSettings(latent=32, width=32, ao_rays=16),
            body_steps=150,
            garment_steps=150,
            joint_steps=300,
            lr=3e-3,
            checkpoint_every=50,
            picture_every=50,
        )
    if quality == "fine":
        return AvatarSettings(
            quality=quality,
            data=DataSettings(geometry_size=256, texture_size=1024, image=(1024, 1024)),
            network=NetworkSettings(width=128, ao_size=128),
            body_steps=10_000,
            garment_steps=10_000,
            joint_steps=40_000,
            checkpoint_every=1000,
            picture_every=1000,
        )
    return AvatarSettings()
