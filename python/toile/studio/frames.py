"""One captured frame after the other: pictures, masks, labels, keypoints and scan, from the simulated truth."""

from __future__ import annotations

import json
import os
import shutil

import numpy as np

from ..io.body import load_body_model
from ..io.files import write_text
from ..io.image import write_image
from ..io.mesh import write_mesh
from ..scene import Mesh
from .cameras import make_cameras
from .keypoints import KeypointTable, noisy
from .labels import wrong_labels
from .lasting import LastingKeypoints, LastingLabels
from .outfit import joined_faces
from .paint import Appearance
from .pictures import OuterSurface, make_sensors, nearest, take_picture
from .scan_faults import spoilt_scan
from .scans import scan
from .sequence import Sequence


class CaptureMaker:
    """Person, cameras and sensors of one sequence; each process has its own. Frames are made in any order."""

    def __init__(self, part, folder, options, seed):
        self.part, self.options, self.seed = part, options, seed
        self.sequence = Sequence(folder, options, seed)
        rng = np.random.default_rng([seed, 2])
        self.rig = make_cameras(options.cameras, options.size, rng, options.span, pinhole=options.renderer == "mitsuba")
        self.sensors = make_sensors(len(self.rig), rng)
        self.body = self.sequence.body
        settled = self.sequence.settled
        self.garment_faces = joined_faces(settled) if settled else None
        self.look = Appearance(options.subject, self.body, [(s.name, s.flat) for s in settled], rng)
        self.table = KeypointTable(load_body_model("anny"))
        self.amounts = options.amounts
        worn = [self.sequence.draped(s) for s in settled]
        self.rest = np.concatenate([self.body.rest, *worn])
        self.lasting_keypoints = LastingKeypoints(self.table, len(self.rig), self.amounts, seed)
        self.lasting_labels = None
        if self.amounts.lasting_labels:
            outer = OuterSurface(
                self.body.rest, self.body.model.f, np.concatenate(worn) if worn else None, self.garment_faces
            )
            self.lasting_labels = LastingLabels(
                outer,
                self.look,
                options.label_error_share,
                options.span / options.size,
                np.random.default_rng([seed, 5]),
            )
        self.tracer = None
        if options.renderer == "mitsuba":
            from .pathtrace import PathTracer

            self.tracer = PathTracer(
                self.look, self.body, self.table.model, [s.faces for s in settled], options.pixel_paths
            )

    def joints_and_keypoints(self, vertices, rotations, translation):
        """True joints (K,3) and keypoints (q,3) of one frame."""
        joints = self.body.joints(rotations, translation)
        return joints, self.table.points(vertices, joints)

    def capture(self, number):
        """Makes frame `number` unless it is there; yields its number."""
        target = self.part / "frames" / f"{number:06d}"
        if not target.exists():
            folder = self.part / "work" / f"frame{number:06d}.{os.getpid()}"
            shutil.rmtree(folder, ignore_errors=True)
            share = self._write(folder, number)
            write_text(self.share_file(number), json.dumps(share))
            target.parent.mkdir(exist_ok=True)
            folder.rename(target)
        yield number

    def share_file(self, number):
        """Where the share of wrong label pixels of a frame stands until the capture is whole."""
        return self.part / "work" / f"label_error_share.{number:06d}.json"

    def _write(self, folder, number):
        """Everything of one frame; gives the share of wrong label pixels, None without pictures. Draws from a stream of its own."""
        options = self.options
        rng = np.random.default_rng([self.seed, 3, number])
        vertices, garment = self.sequence.frame(number)
        outer = OuterSurface(vertices, self.body.model.f, garment, self.garment_faces, self.rest)
        block, i = self.sequence.block_of(number)
        joints, points = self.joints_and_keypoints(vertices, block.rotations[i], block.translation[i])
        if number not in options.pictured:
            folder.mkdir(parents=True)
            self._write_keypoints(folder, number, points, [nearest(outer, camera) for camera in self.rig], rng)
            return None
        for name in ("images", "masks", "labels"):
            (folder / name).mkdir(parents=True)
        traced = self._traced(outer, number)
        views = [take_picture(outer, c, self.look, s, rng, t) for c, s, t in zip(self.rig, self.sensors, traced)]
        if self.lasting_labels is None:
            labels, share = wrong_labels(views, self.rig, options.label_error_share, rng)
        else:
            labels, share = self.lasting_labels.images(views)
        for camera, view, label in zip(self.rig, views, labels):
            write_image(folder / "images" / f"{camera.name}.jpg", view.image)
            write_image(folder / "masks" / f"{camera.name}.png", view.mask.astype(np.uint8) * 255)
            write_image(folder / "labels" / f"{camera.name}.png", label)
        self._write_keypoints(folder, number, points, [view.depth for view in views], rng)
        scanned = scan(outer, options.scan_faces, options.scan_noise, options.hole_share, rng)
        spoilt = spoilt_scan(*scanned, outer, joints, self.body.model, self.amounts, self.seed, number)
        write_mesh(folder / "scan.ply", Mesh(*spoilt))
        return share

    def _write_keypoints(self, folder, number, points, depths, rng):
        """The true points (q,3) as a detector sees them where each camera sees the `depths` (H,W)."""
        noise, outliers, keypoints = self.options.keypoint_noise, self.options.keypoint_outlier_share, {}
        for c, (camera, depth) in enumerate(zip(self.rig, depths)):
            seen = noisy(self.table, camera, depth, points, noise, outliers, rng)
            keypoints[camera.name] = np.round(self.lasting_keypoints.spoil(seen, c, number), 3).tolist()
        write_json(folder / "keypoints.json", {"names": list(self.table.names), "points": keypoints})

    def _traced(self, outer, number):
        """What the path tracer sees, a picture a camera, or None for each."""
        if self.tracer is None:
            return [None] * len(self.rig)
        scene = self.tracer.scene(outer)
        seeds = np.random.SeedSequence([self.seed, 4, number]).generate_state(len(self.rig))
        return [self.tracer.image(scene, outer, c, int(s)) for c, s in zip(self.rig, seeds)]


def write_json(path, value):
    path.write_text(json.dumps(value) + "\n")
