"""Pictures by path tracing (mitsuba, scalar_rgb): soft boxes over a grey stage, printed garments with a clear coat.

Cameras are ideal pinholes with square pixels, so nothing is warped. Pictures are traced in bands, each as wide as what
stands on the stage there; beside it is the grey wall, whose radiance is known. A box filter and blocks
of a fixed size keep the bits from depending on the number of threads.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from .. import kernels
from .paint import LABELS, TEXTURE
from .surface import barycentric

BODY_TEXTURE = 2048  # texels a side
CHUNK = 1 << 18  # texels painted at a time
BOUNCES = 4
BAND = 32  # rows traced at a time
BLOCK = 16  # pixels a side that one thread traces; each block draws from a stream of its own
MARGIN = 0.05  # m around vertices that a band keeps; edges are shorter
AMBIENT = 0.25  # radiance all around: an endless grey wall
BOXES = (  # soft boxes: centre [m], half a side [m], radiance; above what the cameras see
    ((1.6, -2.4, 4.7), 1.3, 9.0),
    ((-2.5, -1.2, 4.6), 1.2, 2.5),
    ((0.5, 2.6, 4.7), 1.2, 4.0),
)
AIM = (0.0, 0.0, 1.1)  # m, what the boxes face
PLATE, PLATE_REFLECTANCE = 0.60, 0.35  # the round plate on which the person stands: radius [m]
COAT = 0.22  # roughness (GGX alpha) of the garments' clear coat
GLOSS_ROUGHNESS = 0.30  # of the body's gloss
GLOSS = {"skin": 0.4, "hair": 0.6, "trousers": 0.05, "shoes": 0.5}  # share of a part's coat; eyes have all of it
IRIS, PUPIL = 0.47, 0.20  # rad, half angles about the direction of sight
IRIS_COLOUR = np.array([0.24, 0.17, 0.11])


class PathTracer:
    """The look of one person as mitsuba's materials; textures are painted once."""

    def __init__(self, look, body, charts, garments, samples):
        """`charts`: the packaged body model, whose UVs the truth body shares; `garments`: the faces of each."""
        import drjit
        import mitsuba

        mitsuba.set_variant("scalar_rgb")
        drjit.set_thread_count(kernels.threads())
        mitsuba.set_log_level(mitsuba.LogLevel.Error)
        self.mi, self.look, self.body, self.samples = mitsuba, look, body, samples
        self.uv, self.f_uv = charts.uv, charts.f_uv
        self.garments = [PrintedMesh(printed, faces) for printed, faces in zip(look.prints, garments)]

    def scene(self, outer):
        """The stage with the outer surface of one frame on it."""
        mi = self.mi
        stage = {"type": "scene", "integrator": {"type": "path", "max_depth": BOUNCES, "block_size": BLOCK}}
        stage["ambient"] = {"type": "constant", "radiance": {"type": "rgb", "value": AMBIENT}}
        stage["plate"] = {
            "type": "disk", "to_world": mi.ScalarTransform4f().scale([PLATE, PLATE, 1]),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": PLATE_REFLECTANCE}},
        }  # fmt: skip
        for i, (centre, half, radiance) in enumerate(BOXES):
            turn = mi.ScalarTransform4f().look_at(origin=centre, target=AIM, up=[0, 0, 1])
            stage[f"box{i}"] = {
                "type": "rectangle", "to_world": turn @ mi.ScalarTransform4f().scale([half, half, 1]),
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
            }  # fmt: skip
        normals = outer.normals
        n = len(outer.body)
        corner = np.stack([self.body.model.f, self.f_uv], 2).reshape(-1, 2)
        corner, faces = np.unique(corner, axis=0, return_inverse=True)
        stage["body"] = self.mesh(
            "body",
            outer.body[corner[:, 0]],
            normals[:n][corner[:, 0]],
            self.uv[corner[:, 1]] * [1, -1] + [0, 1],
            faces,
            self.body_bsdf,
        )
        for i, garment in enumerate(self.garments):
            of, name = garment.vertex + n, f"garment{i}"
            stage[name] = self.mesh(
                name, outer.vertices[of], normals[of], garment.uv, garment.faces, self.cloth_bsdf[i]
            )
            n += garment.count
        return mi.load_dict(stage)

    def mesh(self, name, vertices, normals, uv, faces, bsdf):
        """UVs count from the picture's upper left corner."""
        properties = self.mi.Properties()
        properties["bsdf"] = bsdf
        faces = np.asarray(faces).reshape(-1, 3)
        mesh = self.mi.Mesh(name, len(vertices), len(faces), properties, True, True)
        parameters = self.mi.traverse(mesh)
        parameters["vertex_positions"] = np.ravel(vertices).astype(np.float32)
        parameters["vertex_normals"] = np.ravel(normals).astype(np.float32)
        parameters["vertex_texcoords"] = np.ravel(uv).astype(np.float32)
        parameters["faces"] = np.ravel(faces).astype(np.uint32)
        parameters.update()
        return mesh

    def image(self, scene, outer, camera, seed):
        """(H,W,3) of sRGB values from 0 to 1, before the sensor; `scene` was made of `outer`."""
        linear = np.full((camera.height, camera.width, 3), AMBIENT)
        for i, (row, col) in enumerate(bands(np.concatenate([outer.vertices, plate_border()]), camera)):
            sensor = self.sensor(camera, row, col)
            linear[row, col] = self.mi.render(scene, sensor=sensor, spp=self.samples, seed=(seed + i) % 2**32)
        return to_srgb(np.clip(linear, 0, 1))

    def sensor(self, camera, row, col):
        """The pixels row x col (slices) of a camera."""
        (h, w), K = camera.size, camera.K
        to_world = np.linalg.inv(camera.T_camera_world) @ np.diag([-1.0, -1.0, 1.0, 1.0])  # mitsuba's x left, y up
        return self.mi.load_dict({
            "type": "perspective", "fov_axis": "x", "fov": float(np.degrees(2 * np.arctan(0.5 * w / K[0, 0]))),
            "principal_point_offset_x": float(0.5 - K[0, 2] / w), "principal_point_offset_y": float(0.5 - K[1, 2] / h),
            "near_clip": 0.1, "far_clip": 100.0, "to_world": self.mi.ScalarTransform4f(to_world),
            "film": {
                "type": "hdrfilm", "width": w, "height": h, "crop_offset_x": col.start, "crop_offset_y": row.start,
                "crop_width": col.stop - col.start, "crop_height": row.stop - row.start,
                "rfilter": {"type": "box"}, "pixel_format": "rgb", "component_format": "float32",
            },
            "sampler": {"type": "multijitter", "sample_count": self.samples},
        })  # fmt: skip

    def bitmap(self, pixels, raw):
        """A texture of values from 0 to 1: sRGB colours, or `raw` numbers."""
        data = np.ascontiguousarray((np.clip(pixels, 0, 1) * 255 + 0.5).astype(np.uint8))
        return self.mi.load_dict({"type": "bitmap", "bitmap": self.mi.Bitmap(data), "raw": raw, "wrap_mode": "clamp"})

    @cached_property
    def cloth_bsdf(self):
        """A material a garment."""
        printed = (self.bitmap(p.atlas(), raw=False) for p in self.look.prints)
        return [self.mi.load_dict({"type": "twosided", "bsdf": coat(p, COAT)}) for p in printed]

    @cached_property
    def body_bsdf(self):
        colour, gloss = self.painted_body()
        texture = self.bitmap(colour, raw=False)
        return self.mi.load_dict({"type": "twosided", "bsdf": {
            "type": "blendbsdf", "weight": self.bitmap(gloss[..., None], raw=True),
            "matte": {"type": "diffuse", "reflectance": texture},
            "coat": coat(texture, GLOSS_ROUGHNESS),
        }})  # fmt: skip

    def painted_body(self):
        """The body's texture (T,T,3) and its gloss (T,T), continued beyond the charts' borders."""
        from scipy.ndimage import distance_transform_edt

        T = BODY_TEXTURE
        plane = np.concatenate([self.uv * [T, -T] + [0, T], np.ones((len(self.uv), 1))], 1)
        face = kernels.raster(plane, self.f_uv, np.eye(3), (T, T)).face
        row, col = np.nonzero(face >= 0)
        colour, gloss = np.zeros((T, T, 3)), np.zeros((T, T))
        for part in np.array_split(np.arange(len(row)), max(1, len(row) // CHUNK)):
            r, c = row[part], col[part]
            centre = np.stack([c + 0.5, r + 0.5, np.ones(len(r))], 1)
            colour[r, c], gloss[r, c] = self.paint(face[r, c], centre, plane)
        near = distance_transform_edt(face < 0, return_distances=False, return_indices=True)
        return colour[tuple(near)], gloss[tuple(near)]

    def paint(self, face, centre, plane):
        look, f = self.look, self.body.model.f[face]
        bary = barycentric(centre, plane[self.f_uv[face]])
        at = lambda values: np.einsum("pc,pc...->p...", bary, values[f])
        neutral, skin = at(look.neutral), look.skin_vertex[f[:, 0]]
        label = look.body_labels(neutral, at(look.arm), at(look.head))
        colour = look.body_colours(neutral, label, skin)
        table = np.zeros(max(LABELS.values()) + 1)
        for name, value in GLOSS.items():
            table[LABELS[name]] = value
        colour[~skin] = self.eye_colours(neutral[~skin], colour[~skin])
        return colour, np.where(skin, table[label], 1.0)

    def eye_colours(self, neutral, colour):
        """Iris and pupil on the eyeballs; their joints are the centres; the body faces -y."""
        for side in "LR":
            centre = self.eye_centre(side)
            d = neutral - centre
            angle = np.arccos(np.clip(-d[:, 1] / np.maximum(np.linalg.norm(d, axis=1), 1e-9), -1, 1))
            mine = np.linalg.norm(d, axis=1) < 0.03
            colour[mine & (angle < IRIS)] = IRIS_COLOUR
            colour[mine & (angle < PUPIL)] = 0.03
        return colour

    def eye_centre(self, side):
        W = self.body.dense_weights[:, self.body.model.joint(f"eye.{side}")]
        ball = self.look.neutral[(W > 0.5) & ~self.look.skin_vertex]
        return 0.5 * (ball.min(0) + ball.max(0))


def coat(colour, alpha):
    """A diffuse colour under a rough dielectric coat: what that reflects grows at grazing angles (Fresnel)."""
    coat = {"type": "roughplastic", "distribution": "ggx", "alpha": alpha, "int_ior": 1.5}
    return coat | {"diffuse_reflectance": colour}


class PrintedMesh:
    """The garment cut where the print passes from front to back: `vertex` (p,) of the garment, `uv` (p,2), `faces`."""

    def __init__(self, printed, faces):
        flat = printed.flat
        self.count = len(flat)
        back = flat[faces, 1].mean(1) >= 0
        corner = np.stack([faces, np.broadcast_to(back[:, None], faces.shape)], 2).reshape(-1, 2)
        corner, index = np.unique(corner, axis=0, return_inverse=True)
        self.vertex, self.faces = corner[:, 0], index.reshape(-1, 3)
        u, v = printed.texels(flat[self.vertex])
        side = corner[:, 1]
        u = np.where(side == 1, TEXTURE - 1 - u, u)
        self.uv = np.stack([(u + 0.5 + TEXTURE * side) / (2 * TEXTURE), (v + 0.5) / TEXTURE], 1)


def plate_border():
    """Points (n,3) around the plate, closer together than MARGIN."""
    turn = np.linspace(0, 2 * np.pi, 128)
    return PLATE * np.stack([np.cos(turn), np.sin(turn), np.zeros(128)], 1)


def bands(points, camera):
    """The rows and columns (slices) of each band of BAND rows that sees something within MARGIN of the points."""
    uv, depth = camera.project(points)
    margin = MARGIN * camera.K[0, 0] / depth.min()
    for top in range(0, camera.height, BAND):
        row = slice(top, min(top + BAND, camera.height))
        u = uv[(uv[:, 1] > row.start - margin) & (uv[:, 1] < row.stop + margin), 0]
        if len(u):
            low, high = np.clip([np.floor(u.min() - margin), np.ceil(u.max() + margin)], 0, camera.width).astype(int)
            if low < high:
                yield row, slice(int(low), int(high))


def to_srgb(x):
    """Linear light to sRGB values (IEC 61966-2-1)."""
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
