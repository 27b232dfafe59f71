"""Makes one synthetic capture: body, dressed shirt, motion, checked truth, pictures, labels, keypoints, scans."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from ..scene import CaptureError
from . import truth as checks
from .cameras import cameras_json, make_cameras
from .garment import SIZES
from .keypoints import KeypointTable, noisy
from .labels import wrong_labels
from .motion import FPS
from .paint import LABELS, Look
from .pictures import Outer, make_sensors, take
from .scans import scan, write_ply
from .sequence import make_truth
from .template import make_template, write_obj

GARMENT = "tshirt"
ATTEMPTS = 5  # seeds tried before giving up
THREADS = 2  # frames written at a time


@dataclass(frozen=True)
class StudioOptions:
    """What to capture. Lengths in the unit of the name."""

    frames: int = 20
    cameras: int = 8
    size: int = 512  # px, square pictures
    seed: int = 0
    renderer: str = "raster"
    subject: str = "fitted"  # fitted, logo, loose
    motion: str = "walk"  # walk, rom, talk, hands-on-cloth, or a .bvh file
    noise: float = 1.0  # mm, scan noise
    holes: float = 0.05  # share of the scan's area
    keypoint_noise: float = 2.0  # px
    keypoint_outliers: float = 0.05
    label_errors: float = 0.10  # share of foreground pixels
    scan_faces: int = 60_000
    garment: str | None = "newton"  # newton, cut, the path of a shirt as .obj, or None

    def __post_init__(self):
        positive = ("frames", "cameras", "scan_faces")
        for name in positive:
            if getattr(self, name) < 1:
                raise CaptureError(f"studio: {name} is {getattr(self, name)}, must be at least 1")
        if not 32 <= self.size <= 8192:
            raise CaptureError(f"studio: size is {self.size}, must be 32 to 8192 pixels")
        if self.seed < 0:
            raise CaptureError(f"studio: seed is {self.seed}, must be at least 0")
        for name in ("noise", "keypoint_noise"):
            if not 0 <= getattr(self, name) < np.inf:
                raise CaptureError(f"studio: {name} is {getattr(self, name)}, must be finite and at least 0")
        for name in ("holes", "keypoint_outliers", "label_errors"):
            if not 0 <= getattr(self, name) <= 0.9:
                raise CaptureError(f"studio: {name} is {getattr(self, name)}, must be 0 to 0.9")
        if self.renderer != "raster":
            raise CaptureError(f"studio: renderer is {self.renderer!r}, only 'raster' is there")
        if self.subject not in SIZES:
            raise CaptureError(f"studio: subject is {self.subject!r}, must be one of {', '.join(SIZES)}")
        if self.motion not in MOTIONS and not self.motion.lower().endswith(".bvh"):
            raise CaptureError(f"studio: motion is {self.motion!r}, must be {', '.join(MOTIONS)}, or a .bvh file")


MOTIONS = ("walk", "rom", "talk", "hands-on-cloth")


@dataclass
class StudioReport:
    """What was made and measured."""

    path: Path
    seed: int  # the one whose truth passed
    rejected: list[str] = field(default_factory=list)  # "seed 7: frame 3: ..." of discarded truths
    per_frame: list[dict] = field(default_factory=list)
    figures: dict = field(default_factory=dict)


def make_capture(out, options: StudioOptions, progress=None) -> StudioReport:
    """Writes the capture `out` in one rename; it must not exist. `progress(step, done, total)` is called as it goes.

    A seed whose truth breaks a bound is discarded, reported, and replaced by one derived from it. The same options
    give the same bits. Raises CaptureError on bad options and RuntimeError when ATTEMPTS seeds were discarded.
    """
    out = Path(out)
    progress = progress or (lambda step, done, total: None)
    if out.exists():
        raise CaptureError(f"{out}: exists already; the studio writes new captures only")
    out.parent.mkdir(parents=True, exist_ok=True)
    truth, report = accepted_truth(options, progress)
    report.path = out
    temporary = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    try:
        write_capture(temporary, options, truth, report, progress)
        os.chmod(temporary, 0o755)
        temporary.rename(out)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return report


def accepted_truth(options, progress):
    """The first truth within bounds, and a report that counts the others."""
    report = StudioReport(Path(), options.seed)
    for attempt in range(ATTEMPTS):
        report.seed = options.seed if attempt == 0 else derived_seed(options.seed, attempt)
        try:
            truth = make_truth(options, report.seed, progress)
        except (checks.TruthRejected, FloatingPointError) as reason:
            report.rejected.append(f"seed {report.seed}: {reason}")
            continue
        report.per_frame, report.figures = truth.per_frame, truth.figures
        return truth, report
    raise RuntimeError(f"studio: the truth of {ATTEMPTS} seeds was discarded: " + "; ".join(report.rejected))


def derived_seed(seed, attempt):
    return int(np.random.SeedSequence([seed, attempt]).generate_state(1)[0])


def write_capture(folder, options, truth, report, progress):
    """Writes everything of an accepted truth into `folder`."""
    from ..io.body import load_body_model

    model = load_body_model("anny")
    rng = np.random.default_rng([report.seed, 2])
    rig = make_cameras(options.cameras, options.size, rng)
    sensors = make_sensors(len(rig), rng)
    look = Look(options.subject, truth.body, truth.flat, rng)
    table = KeypointTable(model)
    template = None
    if truth.garment is not None:
        template = make_template(truth.flat, truth.garment_faces, truth.draped, truth.body.rest, model.v_template)
        (folder / "templates").mkdir()
        write_obj(folder / "templates" / f"{GARMENT}.obj", template.mesh)
    (folder / "scene.toml").write_text(scene_toml(options, template is not None))
    write_json(folder / "cameras.json", cameras_json(rig))
    joints = np.array([truth.body.joints(r, t) for r, t in zip(truth.rotations, truth.translation)])
    points = np.array([table.points(v.astype(np.float64), j) for v, j in zip(truth.vertices, joints)])

    def one(k):
        return write_frame(
            folder / "frames" / f"{k:06d}", k, options, truth, report.seed, rig, sensors, look, table, points[k]
        )

    shares = []
    with ThreadPoolExecutor(THREADS) as pool:  # each frame draws from a stream of its own: order does not matter
        for share in pool.map(one, range(options.frames)):
            shares.append(share)
            progress("frames", len(shares), options.frames)
    report.figures["label_error_share"] = float(np.mean(shares))
    write_truth_store(folder / "truth", truth, template, look, table, joints, points, report)
    write_json(folder / "studio.json", studio_json(options, report))


def write_frame(folder, k, options, truth, seed, rig, sensors, look, table, points):
    """Pictures, masks, labels, keypoints and scan of frame k; gives the share of wrong label pixels."""
    rng = np.random.default_rng([seed, 3, k])
    outer = Outer(
        truth.vertices[k].astype(np.float64), truth.body.model.f,
        None if truth.garment is None else truth.garment[k].astype(np.float64), truth.garment_faces,
    )  # fmt: skip
    for name in ("images", "masks", "labels"):
        (folder / name).mkdir(parents=True)
    views = [take(outer, c, look, s, rng) for c, s in zip(rig, sensors)]
    labels, share = wrong_labels(views, rig, options.label_errors, rng)
    keypoints = {}
    for camera, view, label in zip(rig, views, labels):
        write_image(folder / "images" / f"{camera.name}.jpg", view.image)
        write_image(folder / "masks" / f"{camera.name}.png", view.mask.astype(np.uint8) * 255)
        write_image(folder / "labels" / f"{camera.name}.png", label)
        seen = noisy(table, camera, view.depth, points, options.keypoint_noise, options.keypoint_outliers, rng)
        keypoints[camera.name] = np.round(seen, 3).tolist()
    write_json(folder / "keypoints.json", {"names": list(table.names), "points": keypoints})
    write_ply(folder / "scan.ply", *scan(outer, options.scan_faces, 1e-3 * options.noise, options.holes, rng))
    return share


def write_image(path, pixels):
    from PIL import Image

    Image.fromarray(pixels).save(path, **({"quality": 95} if path.suffix == ".jpg" else {}))


def write_json(path, value):
    path.write_text(json.dumps(value) + "\n")


def scene_toml(options, garment):
    labels = {k: v for k, v in LABELS.items() if garment or k != GARMENT}
    name = f"{options.subject}-{Path(options.motion).stem}"
    lines = [
        f'[scene]\nname = "{name}"\nfps = {FPS:g}\nunits = "m"\nup = "z"\n',
        '[body]\nmodel = "anny"\n',
        "[face]\nkeypoints = true\n",
        "[labels]\n" + "".join(f"{k} = {v}\n" for k, v in labels.items()),
    ]
    if garment:
        lines.append(f'[[garment]]\nname = "{GARMENT}"\ntemplate = "templates/{GARMENT}.obj"\nlabel = "{GARMENT}"\n')
    lines.append(f'[cameras]\nfile = "cameras.json"\nview_dependent = {str(options.cameras > 1).lower()}\n')
    return "\n".join(lines)


def write_truth_store(folder, truth, template, look, table, joints, points, report):
    folder.mkdir()
    record = {
        "frames": np.arange(len(truth.vertices), dtype=np.int64),
        "body/vertices": truth.vertices,
        "body/faces": truth.body.model.f,
        "joints": joints,
        "keypoints": points,
        "pose/rotations": truth.rotations,
        "pose/translation": truth.translation,
        "labels": look.vertex_labels(),
        "attrs": {
            "seed": report.seed, "joint_names": list(truth.body.model.joint_names), "keypoint_names": list(table.names),
            "phenotype": truth.body.phenotype, "positions": "float32 metres, scene frame",
            "figures": report.figures, "per_frame": report.per_frame,
        },
    }  # fmt: skip
    if template is not None:
        record |= {
            f"garment/{GARMENT}/vertices": truth.garment, f"garment/{GARMENT}/faces": truth.garment_faces,
            f"garment/{GARMENT}/map_face": template.map_face, f"garment/{GARMENT}/map_bary": template.map_bary,
        }  # fmt: skip
    checks.write_truth(folder / "truth.zarr", record)


def studio_json(options, report):
    from importlib.metadata import version

    packages = ("anny", "newton", "warp-lang", "open3d", "pymeshlab", "xatlas", "libigl", "numpy")
    return {
        "options": asdict(options), "seed": report.seed, "rejected": report.rejected, "figures": report.figures,
        "bounds": {"strain_p99": checks.STRAIN_P99, "strain_max": checks.STRAIN_MAX, "step_m": checks.STEP_MAX},
        "self_contact": "off: the cloth may pierce itself; triangle pairs are counted per frame in truth.zarr",
        "label_errors": "drawn anew for every frame, alike in all views",
        "versions": {p: version(p) for p in packages},
    }  # fmt: skip
