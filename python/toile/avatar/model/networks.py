"""The networks of one layer: what they take and give, and nothing about meshes or cameras.

Convolutions are weight-normalised with a bias of its own for every pixel ("untied"), LeakyReLU 0.2. Every head starts
with gain zero: the untrained networks change nothing of the mean geometry and the mean texture. Maps are kept in
channels-last order, and a transposed 4x4 convolution doubles the resolution: on a CPU both halve the time of the usual
choices. Sizes are powers of two, at least 16 texels (textures 32).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
import torch.nn.functional as F
from torch import nn

from .carried import COMPONENTS
from .gradients import Enlarged, Mixed, Normed
from .temporal import TemporalModel

SLOPE = 0.2  # of the LeakyReLU
LOGVAR = 10.0  # bound of |logvar|: sigma stays within [0.0067, 148]
START_LOGVAR = -4.0  # sigma = 0.135
POSE_CHANNELS, FACE_CHANNELS, FACE_HIDDEN = 16, 8, 32
COLOUR_IN = 0.25  # difference in colour that networks read as 1
COARSEST = 4  # texels along a side of the coarsest maps of encoder and code


class Conv(nn.Module):
    """A convolution w = g v / |v|, one |v| and g per output channel, plus a bias per output channel and pixel.

    `mode`: "same" 3x3; "point" 1x1; "down" 4x4 of stride 2; "up" transposed 4x4 of stride 2. `size`: of the output map.
    With gain 1 it keeps the variance through the LeakyReLU that follows.
    """

    def __init__(self, inputs, outputs, size, mode="same", gain=1.0):
        super().__init__()
        self.mode, self.up = mode, mode == "up"
        k = {"same": 3, "point": 1, "down": 4, "up": 4}[mode]
        shape = (inputs, outputs, k, k) if self.up else (outputs, inputs, k, k)
        self.direction = nn.Parameter(torch.randn(shape) / (inputs * k * k) ** 0.5)  # |v| = 1, so that it turns
        norm = gain * (2 / (1 + SLOPE**2)) ** 0.5 * (2 if self.up else 1)  # 4 of an "up" kernel's 16 taps meet a pixel
        self.gain = nn.Parameter(torch.full((outputs,), float(norm)))
        self.bias = nn.Parameter(torch.zeros(size, size, outputs))  # channels last
        self.folded = None  # what a weight was made of and the weight: where nothing is trained it is made once

    def weight(self):
        if torch.is_grad_enabled():
            self.folded = None
            return self._normed()
        parts = self.direction, self.gain
        if self.folded is None or self._changed(*self.folded[:2]):
            self.folded = [p.detach() for p in parts], [p._version for p in parts], self._normed()
        return self.folded[2]

    def _changed(self, parts, versions):
        """Is either parameter another one, or another in place? What is held cannot lend its place to others."""
        now = zip((self.direction, self.gain), parts, versions)
        return any(p.data_ptr() != was.data_ptr() or p._version != version for p, was, version in now)

    def _normed(self):
        return Normed.apply(self.direction, self.gain, 1 if self.up else 0)

    def forward(self, x):
        w, bias = self.weight(), self.bias.permute(2, 0, 1)
        if self.mode == "up":
            y = F.conv_transpose2d(x, w, stride=2, padding=1)
        elif self.mode == "point":  # a matrix product into planes: half of conv2d's time at 8 channels
            y = Mixed.apply(x.flatten(2), w.flatten(1)).unflatten(2, x.shape[2:])
        else:
            y = F.conv2d(x, w, stride=2 if self.mode == "down" else 1, padding=1)
        return y.add_(bias.to(y.dtype))


def block(*args, **kwargs):
    """A convolution and its LeakyReLU."""
    return nn.Sequential(Conv(*args, **kwargs), nn.LeakyReLU(SLOPE, inplace=True))


def head(inputs, outputs, size, mode="point"):
    """A last convolution, zero at the start."""
    return Conv(inputs, outputs, size, mode, gain=0.0)


def channels_last(x):
    return x.contiguous(memory_format=torch.channels_last)


def resize(maps, size):
    """Maps (B,C,h,h) at another size: averaged when smaller, bilinear when larger."""
    if maps.shape[-1] == size:
        return maps
    if maps.shape[-1] == 2 * size:  # a quarter of avg_pool2d's time
        rows = maps[..., ::2, :] + maps[..., 1::2, :]
        return (rows[..., ::2] + rows[..., 1::2]).mul_(0.25)
    if maps.shape[-1] > size:
        return F.avg_pool2d(maps, maps.shape[-1] // size)
    planes = maps.contiguous()  # a third of the time that it takes channels-last
    if maps.is_cuda:
        return F.interpolate(planes, size=(size, size), mode="bilinear", align_corners=False)
    return Enlarged.apply(planes, size // maps.shape[-1])


def doublings(start, size):
    """The sizes after `start` up to `size`: 16 -> 64 gives 32, 64."""
    sizes = []
    while start < size:
        start *= 2
        sizes.append(start)
    return sizes


class Decoder(nn.Module):
    """Features (B,C,s,s) -> map (B,3,size,size), 0 at the start; half the channels with each doubling."""

    def __init__(self, inputs, start, size, width, least_width):
        super().__init__()
        blocks = [block(inputs, width, start)]
        for s in doublings(start, size):
            narrower = max(width // 2, least_width)
            blocks.append(block(width, narrower, s, mode="up"))
            width = narrower
        self.body, self.head = nn.Sequential(*blocks), head(width, 3, size)

    def forward(self, features):
        return self.head(self.body(features)).float()


class UNet(nn.Module):
    """Map (B,C,size,size) -> (B,outputs,size,size), 0 at the start; strided down to 8 texels, skips added."""

    def __init__(self, inputs, outputs, size, width, widest):
        super().__init__()
        sizes = doublings(8, size)[::-1]
        widths = [min(width * 2**i, widest) for i in range(len(sizes))]
        self.down = nn.ModuleList(
            block(c, w, s // 2, mode="down") for c, w, s in zip([inputs, *widths], widths, sizes, strict=False)
        )
        self.up = nn.ModuleList(
            block(widths[i], widths[i - 1], sizes[i], mode="up") for i in range(len(sizes) - 1, 0, -1)
        )
        self.head = head(widths[0], outputs, size, mode="up")

    def forward(self, x):
        skips = []
        for down in self.down:
            x = down(x)
            skips.append(x)
        for up, skip in zip(self.up, skips[-2::-1], strict=True):
            x = up(x) + skip
        return self.head(x).float()


class PoseMap(nn.Module):
    """Pose features (B,K,C) -> map (B,P,s,s): tiled, masked per joint, mixed by a 1x1 convolution.

    y_p(x) = sum_k m_k(x) sum_c W_pkc f_kc, so a joint acts only where its mask m (K,s,s) lets it; in this order the
    tiled map of K C channels is never built.
    """

    def __init__(self, mask, features, outputs=POSE_CHANNELS):
        super().__init__()
        self.register_buffer("mask", mask, persistent=False)
        self.weight = nn.Parameter(torch.randn(outputs, mask.shape[0], features) * 0.5)

    def forward(self, features):
        k, s, _ = self.mask.shape
        mixed = torch.einsum("pkc,bkc->bpk", self.weight, features)
        return (mixed @ self.mask.reshape(k, s * s)).reshape(len(features), -1, s, s)


class FaceMap(nn.Module):
    """Facial keypoints (B,q,3), normalised, 0 where unseen -> map (B,C,s,s): a code times a learned basis."""

    def __init__(self, points, mask, outputs=FACE_CHANNELS):
        super().__init__()
        self.register_buffer("mask", mask, persistent=False)  # (s,s)
        self.code = nn.Sequential(nn.Linear(3 * points, FACE_HIDDEN), nn.LeakyReLU(SLOPE))
        self.basis = nn.Parameter(torch.randn(FACE_HIDDEN, outputs, *mask.shape) / FACE_HIDDEN**0.5)

    def forward(self, face):
        return torch.einsum("bh,hcij->bcij", self.code(face.flatten(1)), self.basis) * self.mask


class CodeMap(nn.Module):
    """Code z (B,Z) -> map (B,C,s,s)."""

    def __init__(self, latent, start, width):
        super().__init__()
        self.wide = 2 * width
        self.first = nn.Sequential(nn.Linear(latent, self.wide * COARSEST**2), nn.LeakyReLU(SLOPE))
        sizes = doublings(COARSEST, start)
        widths = [*[self.wide] * (len(sizes) - 1), width]
        self.body = nn.Sequential(
            *(block(c, w, s, mode="up") for c, w, s in zip([self.wide, *widths], widths, sizes, strict=False))
        )

    def forward(self, z):
        return self.body(channels_last(self.first(z).reshape(len(z), self.wide, COARSEST, COARSEST)))


class Encoder(nn.Module):
    """Geometry map (B,3,G,G) and texture (B,3,T,T), both as normalised differences from the mean -> mean (B,latent)
    and logvar (B,modes + latent).

    |logvar| < LOGVAR by a tanh, smooth so that KL can always bring it back. The codes start apart from one another with
    little noise: from the prior, KL would win before the decoder, which starts at 0, has learned to read them.
    """

    def __init__(self, sizes):
        super().__init__()
        g, t, w = sizes.geometry, sizes.texture, sizes.least_width
        levels = doublings(g, t)[::-1]
        widths = [min(w * 2**i, sizes.width) for i in range(len(levels))]
        self.texture = nn.Sequential(
            *(block(c, o, s // 2, mode="down") for c, o, s in zip([3, *widths], widths, levels, strict=False))
        )
        width = ([3] + widths)[-1]
        blocks, inputs = [], width + 3
        for s in doublings(COARSEST, g)[::-1]:
            width = min(max(2 * width, w), 2 * sizes.width)
            blocks.append(block(inputs, width, s // 2, mode="down"))
            inputs = width
        self.body = nn.Sequential(*blocks)
        self.mean = nn.Linear(width * COARSEST**2, sizes.latent)
        self.logvar = nn.Linear(width * COARSEST**2, sizes.modes + sizes.latent)
        for linear, spread in ((self.mean, 1.0), (self.logvar, 0.1)):
            nn.init.normal_(linear.weight, std=spread / linear.in_features**0.5)
        nn.init.zeros_(self.mean.bias)
        nn.init.constant_(self.logvar.bias, START_LOGVAR)

    def forward(self, geometry, texture):
        colours = resize(self.texture(channels_last(texture)), geometry.shape[-1])
        x = self.body(torch.cat([channels_last(geometry), colours], dim=1)).flatten(1)
        return self.mean(x).float(), bounded(self.logvar(x).float())


def bounded(raw):
    """logvar: the identity near 0, within +-LOGVAR everywhere."""
    return LOGVAR * torch.tanh(raw / LOGVAR)


def reparameterised(mean, logvar):
    """z = mean + exp(logvar / 2) e, e drawn from the unit Gaussian by torch's generator (Kingma and Welling 2014)."""
    return mean + torch.exp(0.5 * logvar) * torch.randn_like(mean)


class Shadow(nn.Module):
    """AO - AO_mean (B,1,s,s) -> quasi-shadow (B,1,s,s), exactly 1 at the start, between 0 and 1 / sigmoid(2) = 1.135.

    The texture is a mean over poses, so a place can also be brighter than its mean.
    """

    def __init__(self, size, width):
        super().__init__()
        self.unet = UNet(1, 1, size, width, widest=16 * width)

    def forward(self, occlusion):
        return torch.sigmoid(self.unet(channels_last(occlusion)) + 2) * (1 + torch.exp(torch.tensor(-2.0)).item())


@dataclass(frozen=True)
class Sizes:
    """Sizes of one layer's networks, from the settings and the scene."""

    geometry: int  # texels along a side
    texture: int  # of the decoded differences from the mean texture, which may be finer
    latent: int  # numbers of the code that the networks give, besides those of the modes
    width: int  # channels at the decoders' start
    least_width: int
    shadow_width: int
    occlusion: int  # texels along a side of the shadow network's maps
    joints: int = 0  # pose drives this layer when > 0
    pose_features: int = 9  # per joint
    face_points: int = 0
    code: bool = False
    modes: int = 0  # numbers of the code that come before, given from outside
    remainder: int = 0  # harmonics that hold what the code leaves of an encoded shape, which no network sees
    view: bool = False
    shadow: bool = True
    window: int = 0  # poses that the code is regressed from, in place of an encoder
    mask: torch.Tensor | None = field(default=None, repr=False, compare=False)  # (K,s,s), s = start
    head: torch.Tensor | None = field(default=None, repr=False, compare=False)  # (s,s)

    @property
    def start(self):
        """Texels along a side where the decoders begin."""
        return max(self.geometry // 4, 2 * COARSEST)

    @property
    def view_size(self):
        """Reflections are smooth: half the decoded texture's resolution."""
        return self.texture // 2


class LayerNetworks(nn.Module):
    """All networks of one layer; a part that the layer does not need does not exist (None)."""

    def __init__(self, sizes):
        super().__init__()
        self.sizes, start, w = sizes, sizes.start, sizes.width
        blank = torch.zeros(max(sizes.joints, 1), start, start)
        mask = sizes.mask if sizes.mask is not None else blank
        head_mask = sizes.head if sizes.head is not None else blank[0]
        coded = sizes.code or sizes.window > 0
        self.pose = PoseMap(mask, sizes.pose_features) if sizes.joints else None
        self.face = FaceMap(sizes.face_points, head_mask) if sizes.face_points else None
        self.encoder = Encoder(sizes) if sizes.code else None
        self.regressor = TemporalModel(COMPONENTS, sizes.modes + sizes.latent, sizes.window) if sizes.window else None
        self.code = CodeMap(sizes.modes + sizes.latent, start, w) if coded else None
        inputs = POSE_CHANNELS * bool(sizes.joints) + FACE_CHANNELS * bool(sizes.face_points) + w * coded
        self.geometry = Decoder(inputs, start, sizes.geometry, w, sizes.least_width)
        self.texture = Decoder(inputs, start, sizes.texture, w, sizes.least_width)
        self.view = UNet(4, 3, sizes.view_size, sizes.least_width, 2 * w) if sizes.view else None
        self.shadow = Shadow(sizes.occlusion, sizes.shadow_width) if sizes.shadow else None

    def features(self, pose, face, z):
        """What drives the decoders (B,C,start,start): of pose, face and code only those that the layer has."""
        parts = [net(x) for net, x in ((self.pose, pose), (self.face, face), (self.code, z)) if net is not None]
        return channels_last(torch.cat([p.to(parts[0].dtype) for p in parts], dim=1))

    def view_residual(self, texture, cosine):
        """View-dependent residual (B,3,s,s), s = texture, of a small texture (B,3,v,v) seen at n.v (B,1,v,v), v = view_size."""
        seen = self.view(channels_last(torch.cat([(texture - 0.5) / COLOUR_IN, cosine], dim=1)))
        return resize(seen, self.sizes.texture)


def count(module):
    """Number of trained parameters."""
    return sum(p.numel() for p in module.parameters())
