"""Settings of an avatar and its training: every default stands here once; presets and command line fill the same objects."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from ..config import PowerOfTwo, Settings, changed, setting
from ..errors import UserError

LEAST_TEXTURE = 16  # texels along a side of those that networks decode
Side = Annotated[int, Field(ge=1, le=16384)]  # of a crop [px]
Width = Annotated[float, Field(gt=0)]  # of a soft step [m]


class DataSettings(Settings):
    """What is read and unwrapped of a run and its pictures."""

    geometry_size: PowerOfTwo = setting(128, "count", "texels along a side of the position maps", ge=8, le=8192)
    texture_size: PowerOfTwo = setting(512, "count", "texels along a side of the textures", ge=16, le=16384)
    modes: int = setting(
        64, "count", "principal modes of a garment's unposed shape, the first numbers of its code", ge=0, le=4096
    )
    image: tuple[Side, Side] = setting((512, 512), "px", "height and width of the crop")
    pixel_scale: float = setting(1.0, "1", "pixels of the capture along one of the crop's, at least", gt=0)
    crop: Literal["person", "garment", "head"] = setting(
        "person", "name", "person, garment or head: what the crop is centred on"
    )
    face: bool = setting(True, "switch", "facial keypoints drive the layers, where the run has any")
    light: bool = setting(
        True, "switch", "light is told from what it falls on: it stays where it is while the person turns"
    )
    window: int = setting(
        0,
        "count",
        "garments are regressed from so many poses, the frame's own the last, and have no code; 0: by codes",
        ge=0,
    )


class NetworkSettings(Settings):
    """Sizes of the networks."""

    latent: int = setting(64, "count", "numbers of each garment's code, besides its modes", ge=1, le=4096)
    remainder: int = setting(
        32,
        "count",
        "harmonics that hold what the code leaves of an encoded frame's shape; motion drives none",
        ge=0,
        le=512,
    )
    width: int = setting(
        64, "count", "channels of the widest decoder block; halved with each doubled resolution", ge=1, le=4096
    )
    least_width: int = setting(8, "count", "channels of the finest block", ge=1, le=4096)
    shadow_width: int = setting(4, "count", "channels of the shadow network", ge=1, le=4096)
    texture_step: PowerOfTwo = setting(
        1, "count", "texels of the mean texture along one of those that networks read and decode", ge=1
    )
    ao_rays: int = setting(64, "count", "rays of ambient occlusion, per vertex", ge=1, le=65536)
    ao_size: PowerOfTwo = setting(64, "count", "texels along a side of the shadow network's maps", ge=8, le=4096)
    view: bool = setting(
        True, "switch", "textures depend on where they are seen from, if the scene has several cameras"
    )
    shadow: bool = setting(True, "switch", "quasi-shadows from ambient occlusion")


class LossWeights(Settings):
    """Weights of the training's terms: E_body and E_cloth train the layers apart, E_inv together."""

    geometry: float = setting(1.0, "cm^-2", "of a squared error of positions", ge=0)
    laplacian: float = setting(10.0, "cm^-2", "of a squared error of their Laplacians", ge=0)
    texture: float = setting(30.0, "1", "of a squared error of 1 in a colour of 0..1", ge=0)
    kl: float = setting(1e-5, "nat^-1", "of the codes' divergence from a unit Gaussian", ge=0)
    image: float = setting(10.0, "1", "of an error of 1 in a colour of 0..1", ge=0)
    mask: float = setting(10.0, "1", "of an error of 1 in the silhouette", ge=0)
    visibility: float = setting(1.0, "1", "of the layers drawn apart; 0: they are not drawn apart either", ge=0)
    impute: float = setting(
        0.1, "cm^-2", "the baseline only: of what the pose decides, decoded from another latent", ge=0
    )


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

    quality: str = setting("standard", "name", "draft, standard or fine: the preset that the others start from")
    data: DataSettings = DataSettings()
    network: NetworkSettings = NetworkSettings()
    weights: LossWeights = LossWeights()
    body_steps: int = setting(2000, "count", "of the body alone", ge=0)
    garment_steps: int = setting(2000, "count", "of the garments alone", ge=0)
    joint_steps: int = setting(6000, "count", "of inverse rendering, all layers together", ge=0)
    fit_crop: bool = setting(
        True, "switch", "pictures are scaled down until the crop holds what it is centred on, in every frame"
    )
    batch: int = setting(4, "count", "pictures a step on each device, layers apart", ge=1)
    joint_batch: int = setting(2, "count", "the same in inverse rendering", ge=1)
    lr: float = setting(1e-4, "1", "learning rate of AdamW", gt=0, lt=1)
    joint_rate: float = setting(
        0.5, "1", "of it in inverse rendering, whose image and mask terms a larger step makes diverge", gt=0
    )
    colour_lr: float = setting(1e-3, "1", "learning rate of the cameras' gain and bias", gt=0)
    final_rate: float = setting(
        0.1, "1", "share of the learning rate at the end of a phase, along a half cosine", ge=0, le=1
    )
    warm_up_share: float = setting(0.1, "1", "of a phase with a rising learning rate", ge=0, le=1)
    gradient_limit: float = setting(1.0, "1", "largest norm of the gradient", gt=0)
    visibility_widths: tuple[Width, Width] = setting((0.020, 0.005), "m", "of the soft visibility, first and last")
    checkpoint_every: int = setting(250, "count", "steps between checkpoints", ge=1)
    picture_every: int = setting(250, "count", "steps between pictures for the eye", ge=1)
    divergence_ratio: float = setting(10.0, "1", "a loss beyond this multiple of its recent mean has diverged", gt=1)
    divergence_steps: int = setting(32, "count", "steps of that mean", ge=1)
    max_returns: int = setting(
        5, "count", "to the last good checkpoint, each with half the learning rate, before giving up", ge=0
    )
    baseline_lr: tuple[float, ...] = setting(
        (0.5, 1.0, 2.0),
        "1",
        "multiples of lr that the baseline's search tries, and beyond its ends while one of them is the best",
    )
    baseline_search: float = setting(0.05, "1", "share of the steps that each of them gets", gt=0, le=1)
    seed: int = setting(0, "count", "of first weights and drawn batches", ge=0)

    @model_validator(mode="after")
    def _check_decoded(self):
        step, size = self.network.texture_step, self.data.texture_size
        if size // step < LEAST_TEXTURE:
            raise ValueError(
                f"network.texture_step: {step} of {size} texels: fewer than {LEAST_TEXTURE} are left to decode"
            )
        return self

    def phases(self, layered=True):
        """The order of docs/method/avatars.md. The baseline's one surface gets the steps of both layers apart, then the same together."""
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

    model: Literal["window", "damped"] = setting("window", "name", "window, or damped: a state of its own")
    window: int | None = setting(
        None,
        "count",
        "poses that the window model sees, the current one included; none: those of half a second",
        ge=1,
        le=10_000,
    )
    kriged: bool = setting(
        True, "switch", "Gaussian processes of the same windows have as much of a say as frames left out tell"
    )
    channels: int = setting(256, "count", "of its hidden layers", ge=1)
    steps: int = setting(1000, "count", "at most: frames left out say when to stop", ge=1)
    batch: int = setting(64, "count", "windows, or stretches of the damped model, a step", ge=1)
    stretch: int = setting(60, "count", "frames that the damped model is unrolled over", ge=1)
    lr: float = setting(5e-4, "1", "learning rate of AdamW", gt=0, lt=1)
    weight_decay: float = setting(0.01, "1", "of AdamW", ge=0)
    seed: int = setting(0, "count", "of first weights and drawn batches", ge=0)


class ClothSettings(Settings):
    """Garments as cloth that hangs, and how they are measured on the training frames."""

    bending: float = setting(
        1e-6, "N m", "resistance to bending, of jersey: stiffer cloth hangs in fewer folds than shirts do", ge=0
    )
    stretch: float = setting(500.0, "N/m", "resistance to stretch", gt=0)
    density: float = setting(0.2, "kg/m^2", "of the cloth", gt=0)
    friction: float = setting(0.6, "1", "Coulomb's coefficient between cloth and body", ge=0)
    dry_drag: float = setting(
        0.03,
        "m/s^2",
        "deceleration by friction inside the cloth: without it folds creep for seconds after the body",
        ge=0,
    )
    substep: float = setting(1 / 1500, "s", "longest time between two sweeps over the cloth's constraints", gt=0)
    lead: int = setting(15, "count", "frames in which cloth forgets how it began, at most half of those in a row", ge=0)
    clearance: float = setting(
        5.0, "1", "percentile of the registered distances that cloth keeps from the body", ge=0, le=100
    )
    least_margin: float = setting(0.001, "m", "that it keeps at least", gt=0)
    measured: int = setting(10, "count", "frames whose distances from the body are measured, at most", ge=1)
    taught: int = setting(400, "count", "frames that teach the residual, at most", ge=1)

    def solver(self):
        """Options of kernels.DrapeSolver."""
        return self.model_dump(include={"bending", "stretch", "density", "friction", "dry_drag", "substep"})


class AnimateSettings(Settings):
    """What `toile animate` can be asked for besides its options."""

    cloth: ClothSettings = ClothSettings()


class TrainSettings(AvatarSettings):
    """What `toile train` can be asked for: the avatar's settings, and those of --temporal."""

    temporal: TemporalSettings = TemporalSettings()

    def avatar(self) -> AvatarSettings:
        return AvatarSettings.model_construct(**{name: getattr(self, name) for name in AvatarSettings.model_fields})


PRESETS: dict[str, dict[str, Any]] = {
    "draft": {
        "data": {"geometry_size": 64, "texture_size": 256, "modes": 32, "image": (256, 256)},
        "network": {"latent": 32, "width": 32, "ao_rays": 16},
        "body_steps": 150,
        "garment_steps": 150,
        "joint_steps": 300,
        "lr": 3e-3,
        "checkpoint_every": 50,
        "picture_every": 50,
    },
    "standard": {},
    "fine": {
        "data": {"geometry_size": 256, "texture_size": 1024, "image": (1024, 1024)},
        "network": {"width": 128, "ao_size": 128},
        "body_steps": 10_000,
        "garment_steps": 10_000,
        "joint_steps": 40_000,
        "checkpoint_every": 1000,
        "picture_every": 1000,
    },
}


def preset(quality: str) -> AvatarSettings:
    """The settings of a quality preset: sizes of the maps, widths, steps."""
    return train_preset(quality).avatar()


def train_preset(quality: str) -> TrainSettings:
    """The same with those of the temporal model, alike in all qualities."""
    if quality not in PRESETS:
        raise UserError(f"--quality {quality}: expected one of {', '.join(PRESETS)}")
    return changed(TrainSettings(), PRESETS[quality], {"quality": quality})
