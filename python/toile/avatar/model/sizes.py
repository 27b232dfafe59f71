"""Sizes of the networks that a layer of its kind needs, and of a baseline with as many parameters as the layers together."""

from __future__ import annotations

import torch

from .networks import LayerNetworks, Sizes, count

PARITY = 0.1  # largest relative difference between the baseline's number of parameters and the layered avatar's


def modes_of(layer):
    return 0 if layer.modes is None else len(layer.modes)


def layer_sizes(kind, settings, cameras, scene, joints, face_points, modes):
    """Sizes of a layer's networks: only the parts that its kind and the scene ask for."""
    driven, window = kind in ("body", "surface"), settings.data.window if kind == "garment" else 0
    return Sizes(
        geometry=settings.data.geometry_size,
        texture=settings.data.texture_size // settings.network.texture_step,
        latent=settings.network.latent,
        width=settings.network.width,
        least_width=settings.network.least_width,
        shadow_width=settings.network.shadow_width,
        occlusion=settings.network.ao_size,
        joints=joints if driven else 0,
        face_points=face_points if driven else 0,
        code=kind in ("garment", "surface") and not window,
        modes=modes,
        remainder=settings.network.remainder if kind == "garment" else 0,
        view=settings.network.view and len(cameras) > 1 and scene.view_dependent,
        shadow=settings.network.shadow,
        window=window,
    )


def layer_parameters(kinds, settings, *scene):
    """Number of parameters that layers of these kinds have together; nothing is allocated."""
    with torch.device("meta"):
        return sum(count(LayerNetworks(layer_sizes(kind, settings, *scene))) for kind in kinds)


def matched_settings(layered, settings, layers, cameras, scene, joints, face_points=0):
    """The baseline's `settings` with widths that give one surface as many parameters as `layers` have together by the settings
    `layered`, within PARITY; None where no width does."""

    def widened(least):
        factor = least / settings.network.least_width
        width = max(round(settings.network.width * factor), least)
        return settings.model_copy(
            update=dict(network=settings.network.model_copy(update=dict(width=width, least_width=least)))
        )

    def parameters(kinds, settings, modes=settings.data.modes):
        return layer_parameters(kinds, settings, cameras, scene, joints, face_points, modes)

    wanted = parameters([layer.kind for layer in layers], layered, max(map(modes_of, layers)))
    widest = settings.network.least_width * (len(layers) + 1)
    found = min((widened(w) for w in range(1, widest + 1)), key=lambda s: abs(parameters(["surface"], s) - wanted))
    return found if abs(parameters(["surface"], found) / wanted - 1) <= PARITY else None
