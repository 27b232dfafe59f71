"""The commands `toile import`, `toile export` and `toile body-model`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .. import speech
from ..console import Frames, Step

KINDS_HELP = (
    "opencv, colmap, metashape, qualisys, pose2sim, lists: a calibration with pictures about it; "
    "4d-dress, goliath, actorshq, mvhumannet, dna-rendering: a data set"
)


def import_capture(
    kind: Annotated[str, typer.Argument(help=KINDS_HELP)],
    source: Annotated[Path, typer.Argument(help="a folder, or the calibration's file in it")],
    out: Annotated[Path, typer.Argument(help="the capture, a new folder")],
    images: Annotated[Path | None, typer.Option(help="pictures, if not in a folder called images")] = None,
    masks: Annotated[Path | None, typer.Option(help="masks, if not in a folder called masks")] = None,
    labels: Annotated[Path | None, typer.Option(help="label images, if not in a folder called labels")] = None,
    keypoints: Annotated[
        Path | None, typer.Option(help="keypoints as OpenPose's JSON, if not in keypoints, pose, openpose")
    ] = None,
    scans: Annotated[Path | None, typer.Option(help="a mesh a frame, if not in scans or meshes")] = None,
    videos: Annotated[Path | None, typer.Option(help="a film a camera, if not in videos")] = None,
    skeleton: Annotated[
        str, typer.Option(help="the keypoints' list, such as openpose25 or vitpose25, where several are as long")
    ] = "",
    units: Annotated[str, typer.Option(help="of calibration and scans: m, dm, cm, mm, or metres a unit")] = "",
    up: Annotated[str, typer.Option(help="x, y, z, -x, -y, -z; default what the cameras hold up")] = "",
    fps: Annotated[
        float | None,
        typer.Option(help="frames a second; default the data set's, the films', or 30", min=1e-3, max=100_000),
    ] = None,
    frames: Frames = None,
    step: Step = 1,
    offset: Annotated[
        list[str] | None, typer.Option(metavar="CAMERA=N", help="frame 0 is that camera's number N; repeatable")
    ] = None,
    cropped: Annotated[
        bool, typer.Option("--cropped", help="pictures were cut at the right or below after calibrating")
    ] = False,
    scaled: Annotated[
        bool, typer.Option("--scaled", help="pictures were scaled after calibrating: the calibration is, too")
    ] = False,
    undistort: Annotated[
        bool,
        typer.Option("--undistort", help="resample pictures of fisheyes and of lenses of more than five coefficients"),
    ] = False,
    copy: Annotated[bool, typer.Option("--copy", help="copy pictures in place of linking them")] = False,
):
    """Make a capture of somebody else's: a calibration and what lies about it, or a data set. Pictures are linked."""
    from dataclasses import replace

    from ..console import frame_numbers
    from ..errors import UserError
    from .calibration import KINDS
    from .calibration.lenses import refuse_bent
    from .datasets import DATASETS
    from .importing import write_capture
    from .rig import Options, chosen, read_rig

    folders = dict(images=images, masks=masks, labels=labels, keypoints=keypoints, scans=scans, videos=videos)
    if cropped and scaled:
        raise UserError("--cropped: --scaled is given too")
    if kind in KINDS:
        offsets = offsets_of(offset or [])
        options = Options(folders, units, up, skeleton, offsets, fps, cropped, scaled, undistort)
        found = read_rig(kind, source, options)
    elif kind in DATASETS:
        given = [*folders.values(), units, skeleton, offset, cropped, scaled, undistort]
        if any(given):
            raise UserError(f"toile import {kind}: a data set takes --up, --fps, --frames, --step and --copy alone")
        found = DATASETS[kind](source, up)
        refuse_bent(source, found.cameras.values(), "undistort the pictures first")
        found = found if fps is None else replace(found, fps=fps)
    else:
        raise UserError(f"toile import {kind}: expected one of {', '.join([*KINDS, *DATASETS])}")
    found = chosen(found, frame_numbers(frames, sorted(found.frames), step))
    written = write_capture(found, out, f"{kind} {source}", copy)
    frames, cameras = len(written.frames), len(written.cameras)
    speech.result(f"{out}: {frames} frames, {cameras} cameras, up {written.up}", frames=frames, cameras=cameras)
    for note in written.notes:
        speech.result(f"  {note}")
    speech.next_step("inspect", out)


def export(
    path: Annotated[Path, typer.Argument(help="a run, or a folder that toile animate made")],
    out: Annotated[Path, typer.Argument(help="a file, or for obj and ply a new folder")],
    kind: Annotated[
        str | None,
        typer.Option("--format", help="usd, glb, obj, ply, abc, npz, bvh, rrd; default by the file's ending"),
    ] = None,
    layers: Annotated[
        str | None, typer.Option(help="names such as inner,tshirt; default the body and all garments")
    ] = None,
    frames: Frames = None,
    step: Step = 1,
    motion: Annotated[
        str | None,
        typer.Option(
            help="of usd and glb: points, every vertex of every frame, or skeleton, rest surfaces moved by joints"
        ),
    ] = None,
    textures: Annotated[Path | None, typer.Option(help="a folder of pictures LAYER.png over the UV squares")] = None,
):
    """Write a run or an animation for other programs: USD, glTF, Alembic, mesh sequences, arrays, BVH."""
    from ..console import frame_numbers, progress_bars
    from ..errors import UserError
    from .export.source import open_clip, with_frames, with_layers, with_textures
    from .export.writing import MOTIONS, format_of, write_clip
    from .run import is_run, open_run

    kind = format_of(out, kind)
    if motion not in (None, *MOTIONS):
        raise UserError(f"--motion {motion}: expected points or skeleton")
    surfaces = {"--layers": layers, "--motion points": motion == "points", "--textures": textures}
    if kind == "bvh" and (given := [name for name, value in surfaces.items() if value]):
        raise UserError(f"{given[0]}: --format bvh holds the skeleton alone")
    clip = open_clip(path)
    clip = with_frames(clip, frame_numbers(frames, clip.frames, step))
    clip = with_layers(clip, None if layers is None else [name.strip() for name in layers.split(",")])
    clip = clip if textures is None else with_textures(clip, textures)
    with progress_bars() as progress:
        notes = write_clip(clip, out, kind, motion, progress)
    names = "the skeleton" if kind == "bvh" else ", ".join(layer.name for layer in clip.layers)
    speech.result(f"{out}: {len(clip.frames)} frames of {names}", frames=clip.frames)
    for note in notes:
        speech.result(f"  {note}")
    for warning in left_out(open_run(path), frames) if is_run(path) else ():
        speech.warn(warning)


def left_out(run, frames):
    """What a user should know of a Run's frames that were asked for: those that are not there, and those judged doubtful or wrong."""
    from ..console import frame_numbers
    from ..frame_numbers import frame_ranges

    absent = sorted(set(frame_numbers(frames, run.frames.tolist())) - set(run.ok))
    found = [run.judgement] if run.judgement else []
    if absent:
        words = f"{len(absent)} frames failed or are not registered, and are left out"
        found.insert(0, f"{run.path}: {words}: {frame_ranges(absent, most=5)}")
    return found


def offsets_of(given):
    """["cam01=3"] -> {"cam01": 3}."""
    from ..errors import UserError

    offsets = {}
    for text in given:
        camera, _, number = text.rpartition("=")
        if not camera or not number.removeprefix("-").isdecimal() or len(number) > 7:
            raise UserError(f"--offset {text}: expected CAMERA=N")
        offsets[camera] = int(number)
    return offsets


def body_model(
    file: Annotated[
        Path,
        typer.Argument(
            help="SMPL, SMPL-H, SMPL-X as distributed (.pkl, .npz), a figure (.glb, .gltf), or MakeHuman's rig.NAME.json"
        ),
    ],
    out: Annotated[Path, typer.Argument(help="the body model, a .npz")],
    shapes: Annotated[int, typer.Option(help="coefficients of shape that are kept", min=1, max=300)] = 10,
    mesh: Annotated[
        Path | None, typer.Option(help="of a MakeHuman rig: the base mesh with its helpers; default base.obj about it")
    ] = None,
):
    """Make a body model file of SMPL, SMPL-H, SMPL-X, a rigged glTF or a MakeHuman rig. Nothing in a pickle is run."""
    from .foreign_body import write_body_model

    speech.result(f"{out}: {write_body_model(file, out, shapes, mesh)}")
