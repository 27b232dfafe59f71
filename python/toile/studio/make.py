"""Makes one synthetic capture: body, garments, motion, checked truth, pictures, labels, keypoints, scans.

The capture OUT grows in OUT.part, beside OUT.part/work, which holds the options it was begun with, the simulation in
blocks, and what the last step needs of each frame. OUT.part becomes OUT by one rename when everything is there.
"""

from __future__ import annotations

import json
import shutil
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..io.files import write_text
from ..io.locks import locked
from ..pipeline.workers import Workers, check_workers, everywhere
from . import truth as checks
from .cameras import cameras_json
from .frames import CaptureMaker, write_json
from .motion import FPS
from .options import StudioOptions
from .outfit import split
from .paint import LABELS, PAINTED
from .sequence import Sequence
from .templates import write_templates

ATTEMPTS = 5  # seeds tried before giving up
PACKAGES = ("anny", "newton", "warp-lang", "open3d", "open3d-cpu", "pymeshlab", "xatlas", "libigl", "mitsuba", "numpy")


@dataclass
class StudioReport:
    """What was made and measured."""

    path: Path
    seed: int  # the one whose truth passed
    rejected: list[str] = field(default_factory=list)  # "seed 7: frame 3: ..." of discarded truths
    per_frame: list[dict] = field(default_factory=list)
    figures: dict = field(default_factory=dict)


def make_capture(out, options: StudioOptions, progress=None, workers=1, scheduler=None) -> StudioReport:
    """Writes the capture `out`, which must not exist; the same call goes on with one that was cut short.

    `progress(step, done, total)` is called as it goes; `workers` processes share the frames, or those of a
    running dask `scheduler`. A seed whose truth breaks
    a bound is discarded, reported, and replaced by one derived from it. The same options give the same bits, however
    many workers and interruptions. UserError: bad options, OUT.part was begun with others, or ATTEMPTS seeds were discarded.
    """
    out = everywhere(Path(out), scheduler)
    part = out.with_name(f"{out.name}.part")
    progress = progress or (lambda step, done, total: None)
    check_workers(workers, scheduler)
    refuse_existing(out)
    work = part / "work"
    if part.exists() and not work.is_dir() and not (part / "studio.json").exists():
        raise UserError(f"{part}: is in the way and holds no capture that was begun")
    with locked(work):
        refuse_existing(out)  # another process may have ended it meanwhile
        fresh = begin(part, options)
        try:
            report = fill(part, options, progress, workers, scheduler)
        except UserError:
            if fresh:
                shutil.rmtree(part)
            raise
        shutil.rmtree(work)
        part.rename(out)
    report.path = out
    return report


def refuse_existing(out):
    if out.exists():
        raise UserError(f"{out}: exists already; the studio writes new captures only")


def begin(part, options):
    """Keeps the options in a new OUT.part, or checks that it was begun with the same ones; says whether it is new."""
    asked = {"options": options.model_dump(), "versions": versions()}
    kept = next((p for p in (part / "studio.json", part / "work" / "options.json") if p.exists()), None)
    if kept is None:
        write_text(part / "work" / "options.json", json.dumps(asked))
        return True
    found = json.loads(kept.read_text())
    # an option that came later had its default
    found["options"] = StudioOptions(truth="plain").model_dump() | found["options"]
    for table, values in asked.items():
        for name, value in values.items():
            if found[table].get(name) != value:
                was = found[table].get(name)
                raise UserError(f"{part}: was begun with {name} {was!r}, not {value!r}; finish it so, or remove it")
    return False


def fill(part, options, progress, workers, scheduler):
    """Makes whatever a begun capture lacks."""
    if (part / "studio.json").exists():
        made = json.loads((part / "studio.json").read_text())
        return StudioReport(part, made["seed"], made["rejected"], figures=made["figures"])
    report, folder = accepted_sequence(part / "work", options, progress)
    stage = CaptureMaker(part, folder, options, report.seed)
    write_scene(part, stage)
    take_frames(stage, folder, progress, workers, scheduler)
    templates = write_templates(part, stage)
    report.figures, report.per_frame = stage.sequence.measures()
    shares = [json.loads(stage.share_file(k).read_text()) for k in options.pictured]
    report.figures["label_error_share"] = float(np.mean(shares))
    write_truth_store(part / "truth", stage, templates, report)
    write_text(part / "studio.json", json.dumps(studio_json(options, report)) + "\n")
    return report


def accepted_sequence(work, options, progress):
    """A report of the first seed whose sequence is within bounds, which counts the others; the sequence's folder."""
    file = work / "rejected.json"
    rejected = json.loads(file.read_text()) if file.exists() else []
    while len(rejected) < ATTEMPTS:
        attempt = len(rejected)
        seed = options.seed if attempt == 0 else derived_seed(options.seed, attempt)
        folder = work / f"attempt{attempt}"
        try:
            Sequence(folder, options, seed).simulate(progress)
        except (checks.TruthRejected, FloatingPointError) as reason:
            rejected.append(f"seed {seed}: {reason}")
            write_text(file, json.dumps(rejected))
            shutil.rmtree(folder)
            continue
        return StudioReport(Path(), seed, rejected), folder
    raise UserError(
        f"{work.parent}: the truth of {ATTEMPTS} seeds was discarded ({'; '.join(rejected)}); remove it, and try another --seed, a "
        "calmer --motion or a looser --subject; --set pairs=N allows intersecting triangles, --set strain=S more stretch"
    )


def derived_seed(seed, attempt):
    return int(np.random.SeedSequence([seed, attempt]).generate_state(1)[0])


def write_scene(part, stage):
    """scene.toml and cameras.json."""
    (part / "scene.toml").write_text(scene_toml(stage.options), encoding="utf-8")
    write_json(part / "cameras.json", cameras_json(stage.rig))


def take_frames(stage, folder, progress, workers, scheduler):
    """All frames that are missing, spread over the workers."""
    numbers = stage.options.captured
    with Workers(workers, CaptureMaker, stage.part, folder, stage.options, stage.seed, scheduler=scheduler) as pool:
        here = (k for number in numbers for k in stage.capture(number))
        for done, _ in enumerate(
            here if workers == 1 and scheduler is None else pool.each(CaptureMaker.capture, numbers)
        ):
            progress("frames", done + 1, len(numbers))


def scene_toml(options):
    garments = [name for name, _ in options.garments]
    labels = {k: v for k, v in LABELS.items() if k in PAINTED or k in garments}
    name = f"{options.subject}-{Path(options.motion).stem}"
    lines = [
        f'[scene]\nname = {json.dumps(name, ensure_ascii=False)}\nfps = {FPS:g}\nunits = "m"\nup = "z"\n',
        '[body]\nmodel = "anny"\n',
        "[face]\nkeypoints = true\n",
        "[labels]\n" + "".join(f"{k} = {v}\n" for k, v in labels.items()),
    ]
    for name in garments:
        lines.append(f'[[garment]]\nname = "{name}"\ntemplate = "templates/{name}.obj"\nlabel = "{name}"\n')
    lines.append(f'[cameras]\nfile = "cameras.json"\nview_dependent = {str(options.cameras > 1).lower()}\n')
    return "\n".join(lines)


def write_truth_store(folder, stage, templates, report):
    """The truth of every simulated frame, pictured or not; `frames` holds the numbers."""
    sequence, body = stage.sequence, stage.body
    attrs = {
        "seed": report.seed, "joint_names": list(body.model.joint_names), "keypoint_names": list(stage.table.names),
        "phenotype": body.phenotype, "positions": "float32 metres, scene frame",
        "figures": report.figures, "per_frame": report.per_frame,
    }  # fmt: skip
    fixed = {
        "frames": np.arange(sequence.frames, dtype=np.int64),
        "body/faces": body.model.f,
        "labels": stage.look.vertex_labels(),
    }
    for s in sequence.settled:
        at = f"garment/{s.name}"
        fixed[f"{at}/faces"] = s.faces
        if (t := templates[s.name]) is not None:
            fixed |= {f"{at}/map_face": t.map_face, f"{at}/map_bary": t.map_bary}

    def garments(b):
        parts = split(b.garment, sequence.settled) if sequence.clothed else ()
        return {f"garment/{s.name}/vertices": part for s, part in zip(sequence.settled, parts)}

    def per_frame():
        for b in sequence.blocks():
            poses = zip(b.vertices.astype(np.float64), b.rotations, b.translation)
            joints, points = map(np.array, zip(*(stage.joints_and_keypoints(*p) for p in poses)))
            yield {
                "body/vertices": b.vertices, "joints": joints, "keypoints": points,
                "pose/rotations": b.rotations, "pose/translation": b.translation,
            } | garments(b)  # fmt: skip

    folder.mkdir(exist_ok=True)
    checks.write_truth(folder / "truth.zarr", attrs, fixed, sequence.frames, per_frame())


def versions():
    """{package: version} of those that are installed: open3d comes under either of two names."""
    from importlib.metadata import PackageNotFoundError, version

    there = {}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            there[package] = version(package)
    return there


def studio_json(options, report):
    return {
        "options": options.model_dump(), "seed": report.seed, "rejected": report.rejected, "figures": report.figures,
        "bounds": {"strain_p99": options.strain, "strain_max": checks.STRAIN_MAX, "step_m": checks.STEP_MAX},
        "self_contact": "off: the cloth may pierce itself; triangle pairs are counted per frame in truth.zarr",
        "label_errors": "alike in all views, and " + ("lasting" if options.amounts.lasting_labels else "drawn every frame"),
        "versions": versions(),
    }  # fmt: skip
