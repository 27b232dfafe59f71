"""The types that flow through the pipeline: what a scene contains, what a capture holds, what each stage gives on.

Metres, seconds, radians; right-handed; the scene declares its up axis. Cameras are OpenCV style: x right, y down,
z forward, and pixel (0,0) has its centre at (0.5, 0.5). Image sizes are (height, width).
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np

from .kernels import InputError, SurfaceIndex
from .kernels.arrays import Anything, Array, Bools, Floats, Ints, as_floats
from .kinematics import blend_skinning, blended_transforms, joint_transforms, unblended
from .lens import distort, lens_limit


class _Record:
    """What is pickled and copied is the fields; what was made from them is made again when asked for."""

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]


@dataclass(frozen=True)
class Mesh(_Record):
    """Triangles: `vertices` (n,3) float64 [m], `faces` (m,3) int32; UVs have a topology of their own."""

    vertices: Anything
    faces: Anything
    uv: Anything | None = None  # (t,2)
    face_uv: Anything | None = None  # (m,3) into uv
    face_labels: Anything | None = None  # (m,) uint8 label ids, 0 for none, where a scan carries its own
    confidence: Anything | None = None  # (n,) 0 to 1, where a scan carries one

    # Made when first asked for, and kept for all stages.

    @cached_property
    def index(self) -> SurfaceIndex:
        """Closest points and rays."""
        return SurfaceIndex(self.vertices, self.faces)

    @cached_property
    def normals(self) -> Floats:
        """Unit normals (n,3) of the vertices."""
        from .kernels import vertex_normals

        return vertex_normals(self.vertices, self.faces)

    @cached_property
    def face_normals(self) -> Floats:
        """(m,3)"""
        from .kernels import face_normals

        return face_normals(self.vertices, self.faces)

    @cached_property
    def edges(self) -> Ints:
        """Undirected edges (e,2), each once."""
        from .kernels import unique_edges

        return unique_edges(self.faces)


@dataclass(frozen=True)
class Camera:
    """One calibrated view. `T_camera_world` (4,4) maps world points into the camera's frame."""

    name: str
    width: int
    height: int
    K: Anything  # (3,3) [px]
    distortion: Anything  # (5,) k1 k2 p1 p2 k3
    T_camera_world: Anything

    @property
    def size(self) -> tuple[int, int]:
        return self.height, self.width

    @property
    def centre(self) -> Floats:
        """Position in the world (3,)."""
        return -self.T_camera_world[:3, :3].T @ self.T_camera_world[:3, 3]

    def to_camera(self, points: Anything) -> Floats:
        """World points (..., 3) in the camera's frame."""
        return points @ self.T_camera_world[:3, :3].T + self.T_camera_world[:3, 3]

    def distort(self, xy: Anything) -> Floats:
        """Ideal normalised coordinates (..., 2) to distorted ones (Brown 1971, OpenCV's order of coefficients)."""
        return distort(xy, self.distortion, self.lens_limit)

    @cached_property
    def lens_limit(self) -> Floats:
        """`lens_limit` of its distortion."""
        return lens_limit(self.distortion)

    def project(self, points: Array) -> tuple[Floats, Floats]:
        """World points (..., 3) -> pixels (..., 2) and depth (...) [m]; what lies behind has depth <= 0."""
        p = self.to_camera(np.asarray(points, dtype=np.float64))
        depth = p[..., 2]
        safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        xy = self.distort(p[..., :2] / safe[..., None])
        return xy @ self.K[:2, :2].T + self.K[:2, 2], depth

    def sees(self, points: Array) -> Bools:
        """bool (n,): which of the world points (n,3) lie before the camera and within its picture."""
        uv, depth = self.project(points)
        within: Bools = (depth > 0) & (uv >= 0).all(1) & (uv < self.size[::-1]).all(1)
        return within


@dataclass(frozen=True)
class Garment:
    """One garment of the scene: `label` is its name in the label table."""

    name: str
    template: str  # path inside the capture; "" for one that is cut from the scans
    label: str
    prints: bool = False  # slip is corrected by what is printed on it


@dataclass(frozen=True)
class Scene:
    """What the capture contains, as scene.toml says it."""

    name: str
    fps: float
    units: str
    up: str
    body_model: str
    labels: dict[str, int]
    garments: tuple[Garment, ...] = ()  # inner to outer
    face_keypoints: bool = False
    view_dependent: bool = False
    keypoints: str = ""  # an ONNX file of the capture that finds them
    segmenter: str = ""  # an ONNX file of the capture, or the name of a packaged one, that labels pictures


@dataclass(frozen=True)
class Vote:
    """A person's word on a label id: vertices (k,) of the tracked surface carry it (`prefer`) or do not, in some frames or,
    for None, in all."""

    label: int
    vertices: Anything
    prefer: bool
    frames: tuple[int, ...] | None = None


@dataclass(frozen=True)
class Keypoints:
    """2D keypoints of one frame: `points[camera]` (k,3) u, v [px], confidence; unseen = confidence 0."""

    names: tuple[str, ...]
    points: dict[str, Anything]


@dataclass(frozen=True)
class Points3D:
    """Triangulated keypoints: `points` (k,3) [m], NaN where unseen; `sigma` (k,) [m]; `views` (k,) inlier counts; `gate`:
    the reprojection error [px] up to which a detection counted, 0 where they were not triangulated."""

    names: tuple[str, ...]
    points: Anything
    sigma: Anything
    views: Anything
    gate: float = 0.0


@dataclass(frozen=True)
class Frame:
    """One captured frame; a field is empty or None where the capture has none."""

    number: int
    scan: Mesh | None
    keypoints: Keypoints | None = None
    images: dict[str, Anything] = field(default_factory=dict)  # (H,W,3) uint8 RGB
    masks: dict[str, Anything] = field(default_factory=dict)  # (H,W) bool
    labels: dict[str, Anything] = field(default_factory=dict)  # (H,W) uint8 ids
    certainty: dict[str, Anything] = field(default_factory=dict)  # (H,W) uint8 [1/255], of labels that may be unsure
    points3d: Points3D | None = None  # keypoints in space that the capture brings

    @property
    def scan_labels(self) -> Anything | None:
        """Label ids (m,) of the scan's faces; None where it carries none."""
        return None if self.scan is None else self.scan.face_labels

    def silhouette(self, camera: str) -> Anything | None:
        """Where a camera shows the person, (H,W) bool: its mask, else its label image; None without both."""
        labels = self.labels.get(camera)
        return self.masks.get(camera, None if labels is None else labels > 0)

    @property
    def silhouettes(self) -> dict[str, Anything]:
        """`silhouette` of all cameras that have one."""
        return {name: labels > 0 for name, labels in self.labels.items()} | self.masks


INSIDE = ("eyes", "eye_sockets", "mouth_interior", "tongue")  # segments that lie within the skin


@dataclass(frozen=True)
class BodyModel(_Record):
    """A skinned body with a linear shape basis: SMPL-style kinematics over world-aligned local rotations.

    Keypoint k is joint `keypoint_joint[k]` when that is >= 0, else the mean of vertices `keypoint_vertices[k]`.
    `joint_roles` (K,) says what each joint is in the packaged model's words, whatever the model calls it; without them the
    names are the roles.
    """

    v_template: Anything  # (n,3) [m]
    f: Anything  # (m,3)
    J: Anything  # (K,3) [m]
    parents: Anything  # (K,), parents[0] = -1
    weights_idx: Anything  # (n,B)
    weights_val: Anything  # (n,B), rows sum to 1
    shapedirs: Anything  # (n,3,S) unit-variance shape coefficients
    J_shapedirs: Anything  # (K,3,S)
    joint_names: tuple[str, ...]
    uv: Anything | None = None  # (t,2)
    f_uv: Anything | None = None  # (m,3)
    keypoint_names: tuple[str, ...] = ()
    keypoint_joint: Anything = field(default_factory=lambda: np.zeros(0, np.int64))  # (q,)
    keypoint_vertices: tuple[Anything, ...] = ()
    segments: dict[str, Anything] = field(default_factory=dict)  # name -> vertex indices, see io.body.SEGMENTS
    joint_roles: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint_roles", self.joint_roles or self.joint_names)

    @cached_property
    def inside(self) -> Bools:
        """bool (n,): vertices of segments that no camera and no scan sees."""
        inside = np.zeros(len(self.v_template), bool)
        for name in INSIDE:
            inside[self.segments.get(name, [])] = True
        return inside

    @cached_property
    def mover(self) -> Ints:
        """(n,): the joint that moves each vertex most, of several the first."""
        most = np.asarray(self.weights_val).argmax(1)[:, None]
        mover: Ints = np.take_along_axis(np.asarray(self.weights_idx), most, 1)[:, 0]
        return mover

    @cached_property
    def skin_faces(self) -> Ints:
        """Faces of the largest connected component: eyes and tongue lie inside it."""
        from .kernels import vertex_components

        component = vertex_components(self.f, len(self.v_template))
        return np.ascontiguousarray(self.f[component[self.f[:, 0]] == np.bincount(component).argmax()])

    @cached_property
    def core(self) -> Any:
        """The C++ twin, built once."""
        from .kernels.body import core_model

        return core_model(self)

    def joint(self, role: str) -> int | None:
        """Index of the joint of this role; None where the model has none."""
        return self.joint_roles.index(role) if role in self.joint_roles else None

    def beyond(self, joint: int) -> Bools:
        """bool (K,): this joint and those that hang from it."""
        beyond = np.arange(len(self.parents)) == joint
        for k, parent in enumerate(self.parents):  # which stand before their children
            beyond[k] |= parent >= 0 and beyond[parent]
        return beyond

    def rest(self, shape: Array) -> tuple[Floats, Floats]:
        """Rest vertices (n,3) and joints (K,3) for the first shape coefficients (s,), the others 0. InputError: more than S."""
        shape = as_floats("rest", "shape", shape, (None,))
        s, S = len(shape), self.shapedirs.shape[2]
        if s > S:
            raise InputError(f"rest: shape has {s} coefficients, the model has {S}")
        return self.v_template + self.shapedirs[..., :s] @ shape, self.J + self.J_shapedirs[..., :s] @ shape

    def joint_transforms(self, J: Array, rotations: Array, translation: Array) -> tuple[Floats, Floats]:
        """Forward kinematics: world rotations (K,3,3) and joint positions (K,3) [m], of rest joints J (K,3) [m], rotation
        vectors (K,3) [rad] about world axes relative to the parent, and translation (3,) [m]. InputError names what has another shape."""
        K = len(self.parents)
        J = as_floats("joint_transforms", "J", J, (K, 3))
        rotations = as_floats("joint_transforms", "rotations", rotations, (K, 3))
        translation = as_floats("joint_transforms", "translation", translation, (3,))
        return joint_transforms(self.parents, J, rotations, translation)

    def skin(self, rest: Array, J: Array, rotations: Array, translation: Array) -> Floats:
        """Linear blend skinning of rest vertices (n,3) [m]; the pose as for `joint_transforms`."""
        V = as_floats("skin", "rest", rest, (len(self.v_template), 3))
        R, x = self.joint_transforms(J, rotations, translation)
        return blend_skinning(V, np.asarray(J), R, x, self.weights_idx, self.weights_val)

    def unskin(self, posed: Array, J: Array, rotations: Array, translation: Array) -> Floats:
        """The inverse of `skin`, per vertex."""
        V = as_floats("unskin", "posed", posed, (len(self.v_template), 3))
        R, x = self.joint_transforms(J, rotations, translation)
        return unblended(V, *blended_transforms(np.asarray(J), R, x, self.weights_idx, self.weights_val))

    def keypoints(self, V: Anything, joints: Anything) -> Floats:
        """Model keypoints (q,3) on posed vertices (n,3) and joints (K,3)."""
        return np.array(
            [joints[j] if j >= 0 else V[v].mean(0) for j, v in zip(self.keypoint_joint, self.keypoint_vertices)]
        ).reshape(-1, 3)

    @property
    def face_names(self) -> list[str]:
        """Names of the facial keypoints."""
        return [name for name in self.keypoint_names if name.startswith("face.")]

    def face_vertices(self, reach: float) -> Ints:
        """Indices (k,) of the vertices that cameras see within `reach` [m] of a facial keypoint, on the mean body."""
        facial = np.array([name.startswith("face.") for name in self.keypoint_names], dtype=bool)
        if not facial.any():
            return np.zeros(0, np.int64)
        points = self.keypoints(self.v_template, self.J)[facial]
        distance = np.linalg.norm(self.v_template[:, None] - points, axis=2).min(1)
        near: Ints = np.flatnonzero((distance < reach) & ~self.inside).astype(np.int32)
        return near


# What the stages give on. Confidence is uint8 per vertex: OBSERVED, INTERPOLATED or HIDDEN.
OBSERVED, INTERPOLATED, HIDDEN = 2, 1, 0


@dataclass(frozen=True)
class Person:
    """What is fixed for a sequence after the preparatory pass: the personalised rest surface (as captured, clothed)."""

    shape: Anything  # (S,) coefficients of the body model
    rest: Anything  # (n,3) rest vertices: model shape plus free-form offsets [m]
    J: Anything  # (K,3) rest joints [m]
    keypoint_offsets: Anything | None = None  # (q,3) of the detector's from the model's, see surface/keypoints.py


@dataclass(frozen=True)
class Tracked:
    """One frame of the single-layer surface."""

    vertices: Anything  # (n,3) [m]
    rotations: Anything  # (K,3) rotation vectors about world axes, relative to the parent [rad]
    translation: Anything  # (3,) [m]
    face: Anything  # (q,3) facial keypoints in the head joint's frame [m], NaN where unseen
    confidence: Anything  # (n,) uint8
    diagnostics: dict[str, float]


@dataclass(frozen=True)
class Segmented:
    """Labels of one frame, as ids of the scene's label table."""

    vertices: Anything  # (n,) uint8, per tracked vertex
    scan_faces: Anything  # (m,) uint8, per scan face
    scan_probability: Anything  # (v, L) float32, smoothed vote fractions per scan *vertex*, columns as `ids`
    ids: Anything  # (L,) uint8
    diagnostics: dict[str, float]
    openings: dict[int, Any] = field(default_factory=dict)  # label id -> border as `curves.Curve`s, garment on the left


@dataclass(frozen=True)
class GarmentTemplate:
    """A garment ready to be registered: its rest shape fits the person's rest pose and joints `Person.J`."""

    name: str
    label: int
    rest: Anything  # (g,3) [m]
    faces: Anything  # (f,3)
    uv: Anything  # (t,2)
    face_uv: Anything  # (f,3)
    skin: Anything  # (g,K) rows sum to 1
    loops: tuple[Anything, ...]  # open loops as vertex cycles
    loop_names: tuple[str, ...]  # see surface.loop_names
    opening_lengths: Anything | None = (
        None  # (l,) [m] of the loops' openings in the sampled frames, NaN where none shows it
    )
    flares: Anything | None = None  # (l,) lengths of loops over those of their girths (surface.girth) as made, or NaN


@dataclass(frozen=True)
class Dressed:
    """One garment in one frame."""

    vertices: Anything  # (g,3) [m]
    confidence: Anything  # (g,) uint8
    diagnostics: dict[str, float]


@dataclass(frozen=True)
class InnerShape:
    """The body under the garments, fused over the sequence: rest vertices (n,3) with joints `Person.J`."""

    rest: Anything
    diagnostics: dict[str, float]


@dataclass(frozen=True)
class Inner:
    """The inner layer of one frame, and the garments moved out of it (inner to outer)."""

    vertices: Anything  # (n,3) [m]
    confidence: Anything  # (n,) uint8
    garments: dict[str, Anything]  # name -> (g,3)
    intersections_left: int
    diagnostics: dict[str, float]
