"""The registration itself seen through its pictures: one camera's picture predicted from the other cameras' texture.

Needs neither truth nor a trained avatar: where correspondence slips between layers or views, the texture that
the others saw lands beside its place.
"""

from __future__ import annotations

import torch

from ..render.renderer import Surface, render
from .metrics import ErrorSums, errors_over, pixel_sets, squared_error, ssim_map

SEEN = 0.5  # share of a pixel's texture that other cameras saw, from which on it counts


def photometric(data, garments):
    """{"mse", "ssim", "psnr", "band_mse", "pixels"} over all pictures of an `AvatarData`, pixels that no other camera of the
    frame saw left out; None where there is none.

    garments: label ids; the band is that of the captured labels.
    """
    total, band = ErrorSums(), ErrorSums()
    for samples in _frames(data):
        for i, sample in enumerate(samples):
            picture = _render(data.layers, sample, _others(samples, data.layers, i))
            seen = (picture[3] > SEEN).numpy() & (sample["mask"] > 0.5).numpy()
            colour = picture[:3] / picture[3].clamp(min=SEEN)
            image, captured = (x.numpy().transpose(1, 2, 0) * seen[..., None] for x in (colour, sample["image"]))
            sets = pixel_sets(seen, sample["labels"].numpy(), garments)
            maps = squared_error(image, captured), ssim_map(image, captured)
            total.add(errors_over(*maps, sets["all"]))
            band.add(errors_over(*maps, sets["band"]))
    if not total.pixels:
        return None
    return {"mse": total.mse, "ssim": total.ssim, "psnr": total.psnr, "band_mse": band.mse, "pixels": total.pixels}


def _frames(data):
    """Samples grouped by frame; a frame's samples follow each other."""
    group = []
    for i in range(len(data)):
        sample = data[i]
        if group and int(group[0]["frame"]) != int(sample["frame"]):
            yield group
            group = []
        group.append(sample)
    if group:
        yield group


def _others(samples, layers, left_out):
    """{layer: (4,T,T)}: weighted mean texture of all samples but one, 0 where none of them saw the texel, and 1 where one did."""
    textures = {}
    for layer in layers:
        colour, weight = torch.zeros_like(samples[0][f"texture.{layer.name}"]), torch.zeros(1)
        for i, sample in enumerate(samples):
            if i != left_out:
                colour = colour + sample[f"texture.{layer.name}"] * sample[f"texel_weight.{layer.name}"]
                weight = weight + sample[f"texel_weight.{layer.name}"]
        known = (weight > 0).float().expand(1, *colour.shape[1:])
        textures[layer.name] = torch.cat([colour / weight.clamp(min=1e-8) * known, known])
    return textures


def _render(layers, sample, textures):
    """(4,H,W) of the registered layers with those textures."""
    surfaces = [
        Surface(
            sample[f"vertices.{layer.name}"],
            torch.as_tensor(layer.faces, dtype=torch.int64),
            torch.as_tensor(layer.uv, dtype=torch.float32),
            torch.as_tensor(layer.face_uv, dtype=torch.int64),
            textures[layer.name],
        )
        for layer in layers
    ]
    return render(surfaces, sample["K"], sample["T_camera_world"], tuple(sample["image"].shape[-2:])).image
