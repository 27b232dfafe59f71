"""A clip with known answers: a bent tube and a patch over it, moved by a chain of three joints."""

import json

import numpy as np

from toile.io import animation
from toile.io.export.clip import Clip, ClipLayer, ClipSkeleton
from toile.io.files import save_record
from toile.io.image import write_image
from toile.io.mesh import write_mesh
from toile.kinematics import blend_skinning, joint_transforms
from toile.scene import Mesh

ROUND, HIGH = 8, 6


def tube(radius):
    """(vertices, faces, uv, face_uv) of an open tube about z whose UVs have a seam."""
    angle, height = np.arange(ROUND) * 2 * np.pi / ROUND, np.linspace(0, 1, HIGH)
    ring = np.stack([np.cos(angle), np.sin(angle)], 1) * radius
    V = np.concatenate([np.c_[ring, np.full(ROUND, z)] for z in height])
    faces, corners = [], []
    for j in range(HIGH - 1):
        for i in range(ROUND):
            at = lambda width, di, dj: (j + dj) * width + (i + di) % width
            for kind, width in ((faces, ROUND), (corners, ROUND + 1)):
                kind.append([at(width, 0, 0), at(width, 1, 0), at(width, 1, 1)])
                kind.append([at(width, 0, 0), at(width, 1, 1), at(width, 0, 1)])
    uv = np.stack(np.meshgrid(np.linspace(0, 1, ROUND + 1), height, indexing="xy"), -1).reshape(-1, 2)
    return V, np.array(faces, np.int32), uv, np.array(corners, np.int32)


def bending_clip(frames=(3, 4, 5, 7), up="z", loose=0.0):
    """`loose` [m]: vertices leave what the skeleton says by so much, in a way of their own a frame."""
    J, parents = np.array([[0, 0, 0.0], [0, 0, 0.4], [0, 0, 0.7]]), (-1, 0, 1)
    names = ("root", "upperarm01.L", "wrist")

    def pose(frame):
        turn = 0.1 * frame
        return np.array([[0.2, 0.1 * turn, turn], [turn, 0, 0.1], [0, -turn, 0]]), np.array([0.1, 0.2, 1.0]) * turn

    def layer(name, radius):
        V, F, uv, face_uv = tube(radius)
        weights = np.clip(1 - np.abs(V[:, 2:] - J[:, 2]) / 0.5, 0, None)
        order = np.argsort(-weights, axis=1)
        joints, weights = order.astype(np.int32), np.take_along_axis(weights, order, 1)
        weights = weights / weights.sum(1, keepdims=True)

        def at(frame):
            R, x = joint_transforms(parents, J, *pose(frame))
            noise = np.random.default_rng(frame).normal(size=V.shape)
            return blend_skinning(V, J, R, x, joints, weights) + loose * noise

        return ClipLayer(name, F, at, uv, face_uv, joints, weights)

    layers = layer("inner", 0.1), layer("t-shirt", 0.12)
    return Clip("bend", 25.0, up, tuple(frames), layers, ClipSkeleton(names, parents, J, pose))


def write_animation(clip, folder, colour=(200, 10, 10)):
    """The clip as `toile animate` leaves one, every layer's texture of one colour."""
    for layer in clip.layers:
        parts = layer.faces, layer.uv, layer.face_uv, layer.joints, layer.weights
        save_record(animation.layer_file(folder, layer.name), animation.AnimatedLayer(*parts))
        write_image(animation.texture_file(folder, layer.name), np.full((8, 8, 3), colour, np.uint8))
        for frame in clip.frames:
            write_mesh(animation.mesh_file(folder, layer.name, frame), Mesh(layer.at(frame), layer.faces))
    poses = [clip.skeleton.pose(frame) for frame in clip.frames]
    moved = np.array(clip.frames), np.array([r for r, _ in poses]), np.array([t for _, t in poses])
    still = clip.skeleton.names, np.array(clip.skeleton.parents), clip.skeleton.J
    save_record(animation.skeleton_file(folder), animation.AnimatedSkeleton(*still, *moved, clip.fps, clip.up))
    names = [layer.name for layer in clip.layers]
    (folder / "animation.json").write_text(json.dumps({"fps": clip.fps, "layers": names}))
