"""The command line: parses, calls, reports. Exit codes: 0 ok, 1 bad input, 2 some frames failed or are wrong, 3 internal error."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from .console import (
    SEEDS,
    WORKERS,
    Changes,
    ConfigFile,
    Scheduler,
    frame_numbers,
    numbers_of,
    positive,
    progress_bars,
    shard_of,
    table,
)
from .errors import UserError, first_line

app = typer.Typer(  # without markup: it would take the units in brackets for styles
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help=__doc__,
    context_settings={"help_option_names": ["-h", "--help"]},
)
LINE = 1000  # characters of a message that are shown
STOPPED = 130
RESUMED = ("register", "reconstruct", "align", "train", "studio")  # the same command goes on with what was stopped


def say_version(asked: bool):
    if asked:
        from . import __version__

        typer.echo(f"toile {__version__}")
        raise typer.Exit


@app.callback()
def begin(
    version: Annotated[
        bool, typer.Option("--version", help="say the version and end", is_eager=True, callback=say_version)
    ] = False,
):
    pass


@app.command()
def plan(capture: Path):
    """Print the stages that a capture asks for, each with the line that asks, and those left out with why."""
    from .io.capture import open_capture
    from .pipeline.blocks import blocks
    from .pipeline.plan import plan as make_plan

    opened = open_capture(capture)
    for warning in opened.warnings:
        typer.echo(f"warning: {warning}", err=True)
    typer.echo(f"{opened.scene.name}: {len(opened.frames)} frames, {len(opened.cameras)} cameras")
    for step in make_plan(opened):
        typer.echo(f"  {'run ' if step.runs else 'skip'}  {step.stage:<12} {step.why}")
    count = len(blocks(opened.frames))
    typer.echo(f"  {count} temporal block{'s' * (count > 1)}: more workers or shards than that have nothing to track")


@app.command()
def detect(
    capture: Path,
    detector: Annotated[
        str | None, typer.Option(help="a program: COMMAND PICTURES OUT [PICTURES OUT ...], run without a shell")
    ] = None,
    model: Annotated[Path | None, typer.Option(help="a network of keypoints, an ONNX file")] = None,
    labels: Annotated[
        str | None, typer.Option(help="label images instead, labels/CAMERA.png, by a network of labels: an ONNX file")
    ] = None,
    frames: Annotated[str | None, typer.Option(help="frame numbers, inclusive ranges: 1-50,60")] = None,
    again: Annotated[
        bool, typer.Option("--again", help="also frames that have keypoints.json, or label images")
    ] = False,
):
    """Find keypoints and masks of the person in a capture's pictures: keypoints.json and masks/ of each frame.

    Without --detector and --model by the network that scene.toml names, else by mediapipe, which `make detector` sets up.
    """
    from .io.capture import open_capture
    from .pipeline.detect import detect as find

    opened = open_capture(capture)
    numbers = frame_numbers(frames, opened.frames)
    if labels is not None:
        if detector is not None or model is not None:
            raise UserError("--labels: --detector or --model is given too")
        return write_label_images(opened, labels, numbers, again)
    with progress_bars() as progress:
        found = find(opened, detector_of(opened, detector, model), numbers, again, progress)
    kept = f", {len(found.kept)} had theirs (--again makes them anew)" if found.kept else ""
    typer.echo(f"{capture}: keypoints in {len(found.written)} frames{kept}")
    for warning in found.warnings:
        typer.echo(f"  warning: {warning}", err=True)


@app.command()
def reconstruct(
    capture: Path,
    out: Annotated[Path, typer.Argument(help="a new capture: all of CAPTURE, and scans; goes on with what is there")],
    quality: Annotated[str | None, typer.Option(help="draft, standard (the default) or fine")] = None,
    frames: Annotated[str | None, typer.Option(help="frame numbers, inclusive ranges: 1-50,60")] = None,
    step: Annotated[int, typer.Option(help="every n-th of those frames", min=1)] = 1,
    workers: Annotated[
        int, typer.Option(help="processes that share the frames; 1: all threads for one frame", min=1, max=WORKERS)
    ] = 1,
    scheduler: Scheduler = None,
    config: ConfigFile = None,
    changes: Changes = None,
):
    """Make scans and 3D keypoints of a capture's pictures and masks: scan.ply and keypoints3d.json of each frame."""
    from .config import from_options
    from .config.stereo import scan_preset
    from .io.capture import open_capture
    from .pipeline.reconstruct import reconstruct as run_stereo

    opened = open_capture(capture)
    numbers = frame_numbers(frames, opened.frames, step)
    settings = from_options(scan_preset, quality, config, changes)
    with progress_bars() as progress:
        done = run_stereo(opened, out, settings, numbers, progress, workers, scheduler)
    kept = f", {len(done.kept)} were there" if done.kept else ""
    typer.echo(f"{out}: scans of {len(done.made)} frames{kept}, {len(done.failed)} failed")
    for line in done.said:
        typer.echo(f"  {line}")
    for number, reason in done.failed.items():
        typer.echo(f"  frame {number}: {reason}", err=True)
    raise typer.Exit(2 if done.failed else 0)


@app.command()
def register(
    capture: Path,
    run: Path,
    quality: Annotated[str | None, typer.Option(help="draft, or standard (the default)")] = None,
    budget: Annotated[float | None, typer.Option(help="seconds a frame: the finest quality that keeps to them")] = None,
    frames: Annotated[str | None, typer.Option(help="frame numbers, inclusive ranges: 1-50,60")] = None,
    step: Annotated[int, typer.Option(help="every n-th of those frames", min=1)] = 1,
    workers: Annotated[
        int, typer.Option(help="processes; each takes whole blocks of 50 frame numbers", min=1, max=WORKERS)
    ] = 1,
    scheduler: Scheduler = None,
    shard: Annotated[
        str, typer.Option(help="i/n: every n-th block from the i-th on; give all n, in any order or at once")
    ] = "1/1",
    retry: Annotated[
        str | None, typer.Option(help="failed: give the failed frames of a run again; wrong: also those judged wrong")
    ] = None,
    verify: Annotated[
        bool, typer.Option("--verify", help="compare the contents of every input that a run has read")
    ] = False,
    template_from_scan: Annotated[
        list[str] | None, typer.Option(help="a garment whose template is cut from the capture itself, by its label")
    ] = None,
    config: ConfigFile = None,
    changes: Changes = None,
):
    """Register a capture: the body and each garment, every frame, in fixed topologies."""
    from .config import changed, from_options, preset
    from .io.capture import open_capture
    from .pipeline.run import RETRIES
    from .pipeline.run import register as run_pipeline
    from .pipeline.scanning import lacks_scan

    if retry not in (None, *RETRIES):
        raise UserError(f"--retry {retry}: expected one of {', '.join(RETRIES)}")
    part, budget = shard_of(shard), positive("--budget", budget)
    opened = open_capture(capture)
    numbers = frame_numbers(frames, opened.frames, step)
    if budget is not None:
        quality = quality_within(budget, quality, opened, numbers)
    settings = from_options(preset, quality, config, changes)
    bare = sum(lacks_scan(opened, number) for number in numbers) if settings.make_scans else 0
    if bare:
        made = "made of their pictures (--set make_scans=false goes without)"
        typer.echo(f"{bare} of {len(numbers)} frames bring no scan: it is {made}", err=True)
    if template_from_scan:
        settings = changed(settings, {"template_from_scan": list(template_from_scan)})
    with progress_bars() as progress:
        outcome = run_pipeline(
            capture, run, settings, numbers, progress, workers, part, retry or False, verify, scheduler
        )
    waiting = f", {len(outcome.pending)} wait for other shards" if outcome.pending else ""
    judged = f" ({len(outcome.doubtful)} doubtful, {len(outcome.wrong)} wrong)" if outcome.ok else ""
    typer.echo(f"{run}: {len(outcome.ok)} frames registered{judged}, {len(outcome.failed)} failed{waiting}")
    for note in outcome.notes:
        typer.echo(f"  {note}", err=True)
    for warning in outcome.warnings:
        typer.echo(f"  warning: {warning}", err=True)
    if outcome.unsupported_contact:
        numbers = ", ".join(map(str, outcome.unsupported_contact))
        typer.echo(f"  unsupported contact, hands touch the cloth: frames {numbers}", err=True)
    for kind, frames_of in {"doubtful": outcome.doubtful, "wrong": outcome.wrong, "failed": outcome.failed}.items():
        for number, reason in frames_of.items():
            typer.echo(f"  frame {number}: {'' if kind == 'failed' else f'{kind}: '}{reason}", err=True)
    raise typer.Exit(2 if outcome.failed or outcome.wrong else 0)


@app.command()
def evaluate(
    path: Annotated[Path, typer.Argument(help="a run or an avatar")],
    frames: Annotated[
        str | None, typer.Option(help="of an avatar: 1-50,60; default: what its training held out")
    ] = None,
    run: Annotated[Path | None, typer.Option(help="of an avatar: its run, if that was moved")] = None,
    driven: Annotated[
        bool, typer.Option("--driven", help="an avatar by poses and face alone, as an animation is")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="only the JSON on stdout")] = False,
):
    """Measure a run against its scans and the truth, or an avatar on held-out pictures, where the capture has them."""
    result = measure(path, frames, run, driven)
    for warning in result.get("warnings", ()):
        typer.echo(f"  warning: {warning}", err=True)
    if as_json:
        typer.echo(json.dumps(result, allow_nan=False))
        return
    for line in table(result["all"]):
        typer.echo(line)
    for frame in result["per_frame"]:
        if frame.get("reasons"):
            typer.echo(f"frame {frame['frame']}: {frame['verdict']}: {'; '.join(frame['reasons'])}")


@app.command()
def report(
    path: Annotated[Path, typer.Argument(help="a run or an avatar")],
    out: Annotated[Path | None, typer.Option(help="default: report.html in that folder")] = None,
    frames: Annotated[
        str | None, typer.Option(help="of an avatar: 1-50,60; default: what its training held out")
    ] = None,
    run: Annotated[Path | None, typer.Option(help="of an avatar: its run, if that was moved")] = None,
    driven: Annotated[
        bool, typer.Option("--driven", help="an avatar by poses and face alone, as an animation is")
    ] = False,
):
    """Write one self-contained HTML page about a run or an avatar."""
    if is_avatar(path):
        from .avatar.measure.report import write_avatar_report

        with progress_bars() as progress:
            options = dict(frames=numbers_of(frames), run=run, progress=progress, driven=driven)
            typer.echo(str(write_avatar_report(path, out, **options)))
        return
    from .measure.report import write_report

    no_avatar(path, frames, run, driven)
    typer.echo(str(write_report(path, out)))


@app.command()
def animate(
    avatar: Annotated[Path, typer.Argument(help="made by toile train --temporal, or its baseline/")],
    motion: Annotated[Path, typer.Argument(help="a run, a .bvh file, or an .npz of rotations, translation and fps")],
    out: Annotated[Path, typer.Argument(help="a new folder: pictures/, meshes/, animation.mp4")],
    frames: Annotated[str | None, typer.Option(help="numbers of the motion's frames: 1-50,60")] = None,
    camera: Annotated[
        str | None, typer.Option(help="one of the avatar's, orbit, or a cameras.json taken in turn")
    ] = None,
    height: Annotated[
        int | None, typer.Option(help="of the pictures [px]; default the camera's", min=16, max=8192)
    ] = None,
    meshes: Annotated[bool, typer.Option(help="also every layer's mesh of every frame")] = True,
    seed: Annotated[int, typer.Option(help="of the code that a baseline is driven by", min=0, max=SEEDS - 1)] = 0,
):
    """Drive an avatar by a motion: pictures, meshes and a film, every garment out of the body."""
    from .avatar.drive.animate import animate as run_animation

    with progress_bars() as progress:
        done = run_animation(avatar, motion, out, numbers_of(frames), camera, height, meshes, seed, progress)
    for warning in done.warnings:
        typer.echo(f"  warning: {warning}", err=True)
    typer.echo(f"{out}: {done.frames} frames, {done.intersections_before} intersecting pairs before untangling")
    typer.echo(f"intersections_left: {done.intersections_left}")


@app.command()
def edit(
    avatar: Annotated[Path, typer.Argument(help="made by toile train, or by toile edit before")],
    out: Annotated[Path, typer.Argument(help="a new folder: an avatar with its garment changed")],
    garment: Annotated[str, typer.Option(help="whose texture is changed")],
    scale: Annotated[str | None, typer.Option(help="R,G,B: factors of its colours")] = None,
    checker: Annotated[int | None, typer.Option(help="a checkerboard of so many squares along the UV square")] = None,
    image: Annotated[
        Path | None, typer.Option(help="a picture over the UV square, or laid --at a place; alpha composes")
    ] = None,
    text: Annotated[str | None, typer.Option(help="a text laid on the front, or --at a place")] = None,
    at: Annotated[str | None, typer.Option(help="U,V: middle of the picture or text, v up; default the front")] = None,
    size: Annotated[float | None, typer.Option(help="its width, a share of the UV square's side; default 0.2")] = None,
    sheet: Annotated[
        bool, typer.Option(help="edit.png and edit.json: layered and baseline in frames of the run")
    ] = True,
    frames: Annotated[
        str | None, typer.Option(help="of the sheet: 1-50,60; default a spread of all with pictures")
    ] = None,
    run: Annotated[Path | None, typer.Option(help="the avatar's run, if that was moved")] = None,
):
    """Change a garment's texture, the body's untouched; its baseline gets the same where the garment lay in the first frame."""
    from .avatar.edit.editing import Change
    from .avatar.edit.editing import edit as run_edit

    change = Change(garment, scale, checker, image, text, at, size)
    with progress_bars() as progress:
        done = run_edit(avatar, out, change, numbers_of(frames), run, sheet, progress)
    typer.echo(f"{out}: {garment}: {done.words}{', and its baseline' if done.baseline else ''}")
    for name in ("layered", "baseline") if done.measured else ():
        found = done.measured[name]
        if found and found["border_mm"] is not None:
            typer.echo(f"{name}: border {found['border_mm']:.1f} mm off, area {100 * found['area_share']:.1f} % off")


@app.command()
def template(
    run: Path,
    out: Annotated[Path, typer.Argument(help="the template, an .obj in the body model's rest pose")],
    name: Annotated[str, typer.Option(help="the garment's name")],
    label: Annotated[str, typer.Option(help="its label in the run's scene")],
):
    """Make a garment template from a run's tracked surface and labels."""
    from .pipeline.template import write_template

    typer.echo(write_template(run, out, name, label))


def write_label_images(capture, network, numbers, again):
    """What `toile detect --labels` does."""
    from .pipeline.labelling import scene_segmenter, write_labels

    segmenter = scene_segmenter(capture, network)
    with progress_bars() as progress:
        done = write_labels(capture, segmenter, numbers, again, progress)
    kept = f", {done.kept} were there (--again makes them anew)" if done.kept else ""
    typer.echo(f"{capture.root}: {done.written} label images{kept}")
    typer.echo(f"  of the person's pixels {100 * done.unsure:.1f} % are unsure")


def detector_of(capture, command, model):
    """The detector that was asked for; one of --detector, --model, scene.toml's network, mediapipe."""
    from .vision.detectors.network import Network
    from .vision.detectors.program import Program, default_python, its_own

    if command is not None and model is not None:
        raise UserError("--detector and --model: one of them")
    if command is not None:
        return Program(command)
    if model is not None or capture.scene.keypoints:
        return Network(capture.root / capture.scene.keypoints if model is None else model)
    python = default_python()
    if python is None:
        raise UserError(
            "no detector: `make detector` sets mediapipe up in .venv-detector; or give --detector COMMAND or --model FILE.onnx"
        )
    return its_own(python)


def quality_within(budget, quality, capture, numbers):
    """The quality that --budget chooses, said with the time and the errors to expect."""
    from .pipeline.budget import choose

    if quality is not None:
        raise UserError(f"--budget {budget}: --quality {quality} is given too")
    quality, seconds, errors = choose(capture, numbers, budget)
    expect = ", ".join(f"{name.removesuffix('_mm')} {value:.1f} mm" for name, value in errors.items())
    typer.echo(f"--budget {budget}: quality {quality}, about {seconds:.2f} s a frame; errors to expect: {expect}")
    return quality


def is_avatar(path):
    return (path / "avatar.json").exists() or (path / "checkpoints").is_dir()  # a stopped training is told so


def measure(path, frames, run, driven):
    """The evaluation of a run or of an avatar."""
    if is_avatar(path):
        from .avatar.measure.evaluation import evaluate_avatar

        with progress_bars() as progress:
            return evaluate_avatar(path, numbers_of(frames), run, progress, driven=driven)
    from .measure.evaluate import evaluate as evaluate_run

    no_avatar(path, frames, run, driven)
    return evaluate_run(path)


def no_avatar(path, frames, run, driven):
    """Refuses the options that are an avatar's."""
    given = {f"--frames {frames}": frames is not None, f"--run {run}": run is not None, "--driven": driven}
    for option, there in given.items():
        if there:
            raise UserError(f"{option}: {path} is no avatar, it has no avatar.json")


def main():
    """Entry point with the exit codes of this page."""
    from .align.command import align
    from .avatar.command import train
    from .config.command import settings
    from .io.command import body_model, export, import_capture
    from .kernels import InputError
    from .measure.command import doctor, inspect
    from .pipeline.command import status, tune
    from .studio.command import studio
    from .view.command import view

    app.command()(align)
    app.command()(train)
    app.command()(studio)
    app.command()(settings)
    app.command()(inspect)
    app.command()(doctor)
    app.command()(status)
    app.command()(tune)
    app.command()(view)
    app.command("import")(import_capture)
    app.command()(export)
    app.command("body-model")(body_model)
    try:
        code = app(standalone_mode=False)
        if code == STOPPED:  # typer's answer to Ctrl-C
            raise KeyboardInterrupt
    except (UserError, InputError) as error:
        code = told(str(error), 1)
    except (typer.Abort, KeyboardInterrupt):
        again = len(sys.argv) > 1 and sys.argv[1] in RESUMED
        code = told(f"stopped; go on with: toile {shlex.join(sys.argv[1:])}" if again else "stopped", STOPPED)
    except (OSError, MemoryError) as error:  # a full disk, a folder that may not be written
        code = told(first_line(error), 1)
    except Exception as error:
        if hasattr(error, "exit_code") and hasattr(error, "format_message"):  # of the command line's own parser
            code = told(error.format_message(), 1)
        else:
            import traceback

            traceback.print_exc()
            code = told(f"internal error: {type(error).__name__}: {error}", 3)
    sys.exit(code or 0)


def told(message, code):
    """The exit code, once the message stands on one line of stderr."""
    line = " ".join(message.split())
    print(f"toile: {line[:LINE]}", file=sys.stderr)
    return code
