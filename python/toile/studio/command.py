"""The command `toile studio`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .. import speech
from ..config import changed, from_options
from ..console import SEEDS, WORKERS, Changes, ConfigFile, Scheduler
from ..errors import UserError

RENAMED = {
    "samples": "pixel_paths",
    "noise": "scan_noise",
    "holes": "hole_share",
    "keypoint_outliers": "keypoint_outlier_share",
    "label_errors": "label_error_share",
}


def studio(
    context: typer.Context,
    out: Annotated[Path, typer.Argument(help="folder of the new capture; goes on with OUT.part")],
    frames: Annotated[int, typer.Option(help="number of frames, 30 a second")] = 20,
    cameras: Annotated[int, typer.Option(help="number of cameras in the ring")] = 8,
    size: Annotated[int, typer.Option(help="width and height of the pictures [px]")] = 512,
    seed: Annotated[int, typer.Option(help="same seed, same bits", min=0, max=SEEDS - 1)] = 0,
    renderer: Annotated[str, typer.Option(help="raster: the own rasteriser; mitsuba: path tracing")] = "raster",
    samples: Annotated[int, typer.Option(help="paths a pixel, mitsuba only")] = 64,
    subject: Annotated[str, typer.Option(help="fitted, logo, loose, child, tall or heavy")] = "fitted",
    motion: Annotated[
        str,
        typer.Option(
            help="walk, rom, talk, hands-on-cloth, fast, sit, some joined by +, or a file: .bvh, or .npz of AMASS (SMPL, SMPL-H, SMPL-X)"
        ),
    ] = "walk",
    image_step: Annotated[int, typer.Option(help="pictures every n-th of the simulated frames")] = 1,
    between: Annotated[
        bool, typer.Option("--between", help="captures those between as well, by their keypoints alone")
    ] = False,
    span: Annotated[float, typer.Option(help="height that the pictures span at the middle of the stage [m]")] = 2.25,
    noise: Annotated[float, typer.Option(help="scan noise, standard deviation [mm]")] = 1.0,
    holes: Annotated[float, typer.Option(help="share of the scan's area cut out")] = 0.05,
    keypoint_noise: Annotated[float, typer.Option(help="standard deviation [px]")] = 2.0,
    keypoint_outliers: Annotated[float, typer.Option(help="share of the keypoints, half of them swaps")] = 0.05,
    label_errors: Annotated[float, typer.Option(help="share of the foreground pixels")] = 0.10,
    scan_faces: Annotated[int, typer.Option(help="triangles of a scan before holes")] = 60_000,
    garment: Annotated[str, typer.Option(help="newton, cut (from the body), or a shirt as .obj")] = "newton",
    no_garment: Annotated[bool, typer.Option("--no-garment", help="the bare body only")] = False,
    trousers: Annotated[bool, typer.Option("--trousers", help="a garment of their own, cut from the body")] = False,
    wear: Annotated[
        str, typer.Option(help="garments joined by +, inner to outer: baselayer+tshirt, trousers+tank, dress, ...")
    ] = "",
    truth: Annotated[str, typer.Option(help="plain, hard, or parts of it joined by +")] = "hard",
    template: Annotated[str, typer.Option(help="other, scan, settled, or a foreign garment as .obj")] = "other",
    workers: Annotated[
        int, typer.Option(help="processes that share the frames; 0: as many as processors", min=0, max=WORKERS)
    ] = 0,
    scheduler: Scheduler = None,
    config: ConfigFile = None,
    changes: Changes = None,
):
    """Make a synthetic capture with full truth: pictures, masks, labels, keypoints, scans."""
    from ..console import progress_bars
    from ..kernels import threads
    from .make import make_capture
    from .options import StudioOptions

    given = {
        **dict(
            frames=frames, cameras=cameras, size=size, seed=seed, renderer=renderer, samples=samples, subject=subject
        ),
        **dict(motion=motion, image_step=image_step, between=between, span=span, noise=noise, holes=holes),
        **dict(
            keypoint_noise=keypoint_noise,
            keypoint_outliers=keypoint_outliers,
            label_errors=label_errors,
            scan_faces=scan_faces,
            garment=garment,
        ),
        **dict(trousers=trousers, wear=wear, truth=truth, template=template),
    }
    given = {name: value for name, value in given.items() if is_given(context, name)}
    check_clothes(given, no_garment)
    own = own_options(given, no_garment)
    options = changed(from_options(lambda _: StudioOptions(), None, config, changes), own)
    with progress_bars() as progress:
        report = make_capture(out, options, progress, 1 if scheduler else workers or threads(), scheduler)
    for reason in report.rejected:
        speech.result(f"discarded {reason}")
    frames, discarded = len(options.captured), len(report.rejected)
    words = (
        f"{report.path}: {frames} frames, {options.cameras} cameras, seed {report.seed}, {discarded} seeds discarded"
    )
    speech.result(words, frames=frames, cameras=options.cameras, seed=report.seed)
    speech.next_step("register", out, "run")


def is_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def check_clothes(given: dict[str, Any], no_garment: bool) -> None:
    """UserError: options of clothes that contradict."""
    for name in ("garment", "wear") if no_garment else ():
        if name in given:
            raise UserError(f"--no-garment: --{name} {given[name]} is given too")
    if "wear" in given and "trousers" in given:
        raise UserError(f"--trousers: --wear {given['wear']} is given too: name them there")


def own_options(given: dict[str, Any], no_garment: bool) -> dict[str, Any]:
    """Options as StudioOptions has them: lengths in metres, shares named so."""
    if "noise" in given:
        given["noise"] *= 1e-3
    if no_garment:
        given["garment"] = None
    return {RENAMED.get(name, name): value for name, value in given.items()}
