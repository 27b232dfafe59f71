"""The command line: parses, calls, reports. Exit codes: 0 ok, 1 bad input, 2 some frames failed or are wrong, 3 internal error."""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
import sys
import traceback
from pathlib import Path
from typing import Annotated

import typer
from typer.completion import completion_init

from . import speech
from .align.command import align
from .avatar.command import animate, edit, train
from .config.command import settings
from .console import (
    COMPLETE,
    Changes,
    ConfigFile,
    Holdout,
    Scheduler,
    Workers,
    completion,
    frame_numbers,
    numbers_of,
    positive,
    progress_bars,
    shard_of,
    shown,
    spoken,
    table,
)
from .errors import UserError, first_line
from .io.command import body_model, export, import_capture
from .kernels import InputError
from .measure.command import doctor, inspect
from .pipeline.command import check_frames, go_on, status, tune
from .scene import frame_ranges
from .studio.command import studio
from .view.command import view

app = typer.Typer(  # without markup: it would take the units in brackets for styles
    add_completion=False,
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


@app.callback(invoke_without_command=True)
def begin(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="say the version and end", is_eager=True, callback=say_version)
    ] = False,
):
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(1)


@app.command()
@spoken
def plan(capture: Path):
    """Print the stages that a capture asks for, each with the line that asks, and those left out with why."""
    from .io.capture import open_capture
    from .pipeline.blocks import blocks
    from .pipeline.plan import plan as make_plan

    opened = open_capture(capture)
    for warning in opened.warnings:
        speech.warn(warning)
    cameras = len(opened.cameras)
    speech.result(
        f"{opened.scene.name}: {len(opened.frames)} frames, {cameras} cameras", frames=opened.frames, cameras=cameras
    )
    for step in make_plan(opened):
        words = f"  {'run ' if step.runs else 'skip'}  {step.stage:<12} {step.why}"
        speech.result(words, stage=step.stage, runs=step.runs, why=step.why)
    count = len(blocks(opened.frames))
    words = f"  {count} temporal block{'s' * (count > 1)}: more workers or shards than that have nothing to track"
    speech.result(words, blocks=count)
    speech.next_step("register", capture, "run")


@app.command()
@spoken
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
    workers: Workers = 1,
    scheduler: Scheduler = None,
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
        return write_label_images(opened, labels, numbers, again, workers, scheduler)
    with progress_bars() as progress:
        found = find(opened, detector_of(opened, detector, model), numbers, again, progress, workers, scheduler)
    kept = f", {len(found.kept)} had theirs (--again makes them anew)" if found.kept else ""
    speech.result(f"{capture}: keypoints in {len(found.written)} frames{kept}", written=found.written, kept=found.kept)
    for warning in found.warnings:
        speech.warn(warning)
    speech.next_step("inspect", capture)


@app.command()
@spoken
def reconstruct(
    capture: Path,
    out: Annotated[Path, typer.Argument(help="a new capture: all of CAPTURE, and scans; goes on with what is there")],
    quality: Annotated[str | None, typer.Option(help="draft, standard (the default) or fine")] = None,
    frames: Annotated[str | None, typer.Option(help="frame numbers, inclusive ranges: 1-50,60")] = None,
    step: Annotated[int, typer.Option(help="every n-th of those frames", min=1)] = 1,
    workers: Workers = 1,
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
    words = f"{out}: scans of {len(done.made)} frames{kept}, {len(done.failed)} failed"
    speech.result(words, made=done.made, kept=done.kept, failed=done.failed)
    for line in done.said:
        speech.result(f"  {line}")
    for number, reason in done.failed.items():
        speech.frame_note(number, "failed", reason)
    speech.next_step("register", out, "run")
    raise typer.Exit(2 if done.failed else 0)


@app.command()
@spoken
def register(
    capture: Path,
    run: Path,
    quality: Annotated[str | None, typer.Option(help="draft, or standard (the default)")] = None,
    budget: Annotated[float | None, typer.Option(help="seconds a frame: the finest quality that keeps to them")] = None,
    frames: Annotated[str | None, typer.Option(help="frame numbers, inclusive ranges: 1-50,60")] = None,
    step: Annotated[int, typer.Option(help="every n-th of those frames", min=1)] = 1,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    shard: Annotated[
        str, typer.Option(help="i/n: every n-th block from the i-th on; give all n, in any order or at once")
    ] = "1/1",
    retry: Annotated[
        str | None,
        typer.Option(
            help="frames to give again: failed, wrong (those judged wrong too), worst:20, or numbers, 1-50,60"
        ),
    ] = None,
    frame_limit: Annotated[
        float | None, typer.Option(help="seconds after which a frame fails, looked at when a stage of it ends")
    ] = None,
    keep: Annotated[
        bool, typer.Option(help="keep RUN/work, so that a changed setting redoes only what depends on it")
    ] = True,
    verify: Annotated[
        bool, typer.Option("--verify", help="compare the contents of every input that a run has read")
    ] = False,
    check: Annotated[
        bool, typer.Option("--check", help="only read every file of those frames, name the bad ones, and make nothing")
    ] = False,
    moved: Annotated[
        bool, typer.Option("--moved", help="only note that the capture of this run, or aligned run, lies there now")
    ] = False,
    template_from_scan: Annotated[
        list[str] | None, typer.Option(help="a garment whose template is cut from the capture itself, by its label")
    ] = None,
    holdout: Holdout = None,
    config: ConfigFile = None,
    changes: Changes = None,
):
    """Register a capture: the body and each garment, every frame, in fixed topologies.

    Of a run that is there, what is not given stays as it was asked: settings and frames. What depends on a setting or a
    file that has changed is made again, and nothing else.
    """
    from .config import changed, from_options, preset
    from .io.capture import open_capture
    from .io.holdout import apart, span_of
    from .pipeline.manifest import config_of, note_moved
    from .pipeline.run import register as run_pipeline
    from .pipeline.scanning import lacks_scan

    again, limit = retried(retry), positive("--frame-limit", frame_limit)
    part, budget = shard_of(shard), positive("--budget", budget)
    opened = open_capture(capture)
    if moved:
        note_moved(run, opened)
        return speech.result(f"{run}: its capture is {capture}")
    numbers = frame_numbers(frames, opened.frames, step)
    if check:
        return check_frames(opened, numbers, run)
    own = {"template_from_scan": list(template_from_scan)} if template_from_scan else {}
    own |= {} if holdout is None else {"holdout": span_of(holdout)}
    named = quality or budget or config or any(word.startswith("quality") for word in changes or ())
    before = config_of(run)
    afresh = preset if before is None else lambda name: changed(preset(name), {"holdout": before.holdout})
    base = afresh if named or before is None else lambda _: before
    settings_of = lambda name: changed(from_options(base, name, config, changes), own)
    if budget is not None:
        if quality is not None:
            raise UserError(f"--budget {budget:g}: --quality {quality} is given too")
        seen = apart(numbers, settings_of(quality).holdout)
        quality = quality_within(budget, opened, run, seen, settings_of)
    settings, new = settings_of(quality), not run.exists()
    bare = sum(lacks_scan(opened, number) for number in numbers) if settings.make_scans and new else 0
    if bare:
        made = "made of their pictures (--set make_scans=false goes without)"
        speech.note(f"{bare} of {len(numbers)} frames bring no scan: it is {made}")
    with progress_bars() as progress:
        asked = None if frames is None and step == 1 else numbers
        options = dict(verify=verify, scheduler=scheduler, frame_limit=limit, keep=keep)
        outcome = run_pipeline(capture, run, settings, asked, progress, workers, part, again, **options)
    waiting = f", {len(outcome.pending)} wait for other shards" if outcome.pending else ""
    judged = f" ({len(outcome.doubtful)} doubtful, {len(outcome.wrong)} wrong)" if outcome.ok else ""
    words = f"{run}: {len(outcome.ok)} frames registered{judged}, {len(outcome.failed)} failed{waiting}"
    of_verdict = {"doubtful": outcome.doubtful, "wrong": outcome.wrong, "failed": outcome.failed}
    speech.result(words, registered=outcome.ok, pending=outcome.pending, **of_verdict)
    for note in outcome.notes:
        speech.note(f"  {note}")
    for warning in outcome.warnings:
        speech.warn(warning)
    if outcome.unsupported_contact:
        speech.warn(f"unsupported contact, hands touch the cloth: frames {frame_ranges(outcome.unsupported_contact)}")
    for verdict, reasons in of_verdict.items():
        for number, reason in reasons.items():
            speech.frame_note(number, verdict, reason)
    go_on(run, outcome)
    raise typer.Exit(2 if outcome.failed or outcome.wrong else 0)


@app.command()
@spoken
def evaluate(
    path: Annotated[Path, typer.Argument(help="a run or an avatar")],
    frames: Annotated[
        str | None, typer.Option(help="of an avatar: 1-50,60; default: what its training held out")
    ] = None,
    run: Annotated[Path | None, typer.Option(help="of an avatar: its run, if that was moved")] = None,
    driven: Annotated[
        bool, typer.Option("--driven", help="an avatar by poses and face alone, as an animation is")
    ] = False,
    physics: Annotated[bool, typer.Option("--physics", help="with --driven: garments hang as cloth")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="only the JSON on stdout")] = False,
):
    """Measure a run against its scans and the truth, or an avatar on held-out pictures, where the capture has them."""
    if physics and not driven:
        raise UserError("--physics: it drives an avatar: give --driven too")
    result = measure(path, frames, run, driven, physics)
    for warning in result.get("warnings", ()):
        speech.warn(warning)
    if as_json:
        typer.echo(json.dumps(result, allow_nan=False))
        return
    for line in table(result["all"]):
        typer.echo(line)
    for frame in result["per_frame"]:
        if frame.get("reasons"):
            typer.echo(f"frame {frame['frame']}: {frame['verdict']}: {'; '.join(frame['reasons'])}")
    speech.next_step("report", path)


@app.command()
@spoken
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
            speech.result(str(write_avatar_report(path, out, **options)))
        return speech.next_step("view", path)
    from .measure.report import write_report

    no_avatar(path, frames, run, driven)
    with progress_bars() as progress:
        written = write_report(path, out, progress=progress)
    speech.result(str(written))
    speech.next_step("view", path)


@app.command()
@spoken
def template(
    run: Path,
    out: Annotated[Path, typer.Argument(help="the template, an .obj in the body model's rest pose")],
    name: Annotated[str, typer.Option(help="the garment's name")],
    label: Annotated[str, typer.Option(help="its label in the run's scene")],
):
    """Make a garment template from a run's tracked surface and labels."""
    from .pipeline.template import write_template

    speech.result(write_template(run, out, name, label))


def retried(text):
    """What --retry asks for, as `register` takes it."""
    if text is None:
        return False
    if text in ("failed", "wrong") or re.fullmatch("worst:[1-9][0-9]{0,5}", text):
        return text
    try:
        return numbers_of(text)
    except UserError:
        said = "expected failed, wrong, worst:N or frame numbers such as 1-50,60"
        raise UserError(f"--retry {shown(text)}: {said}") from None


def write_label_images(capture, network, numbers, again, workers, scheduler):
    """What `toile detect --labels` does."""
    from .pipeline.labelling import write_labels

    with progress_bars() as progress:
        done = write_labels(capture, network, numbers, again, progress, workers, scheduler)
    kept = f", {done.kept} were there (--again makes them anew)" if done.kept else ""
    speech.result(f"{capture.root}: {done.written} label images{kept}", written=done.written, kept=done.kept)
    speech.result(f"  of the person's pixels {100 * done.unsure:.1f} % are unsure", unsure=done.unsure)
    speech.next_step("inspect", capture.root)


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


def quality_within(budget, capture, run, numbers, settings):
    """The quality that --budget chooses, said with the time and the errors to expect; that of a run which goes on."""
    from .io.run_folder import config_file, read_config
    from .pipeline.budget import choose

    if config_file(run).exists():
        return read_config(run).get("settings", {}).get("quality")
    with progress_bars() as progress:
        quality, seconds, errors = choose(capture, numbers, budget, settings, progress)
    expect = ", ".join(f"{name.removesuffix('_mm')} {value:.1f} mm" for name, value in errors.items())
    speech.result(f"--budget {budget}: quality {quality}, about {seconds:.2f} s a frame; on frames tried: {expect}")
    return quality


def is_avatar(path):
    return (path / "avatar.json").exists() or (path / "checkpoints").is_dir()  # a stopped training is told so


def measure(path, frames, run, driven, physics=False):
    """The evaluation of a run or of an avatar."""
    if is_avatar(path):
        from .avatar.measure.evaluation import evaluate_avatar

        with progress_bars() as progress:
            return evaluate_avatar(path, numbers_of(frames), run, progress, driven=driven, physics=physics)
    from .measure.evaluate import evaluate as evaluate_run

    no_avatar(path, frames, run, driven)
    return evaluate_run(path)


def no_avatar(path, frames, run, driven):
    """Refuses the options that are an avatar's."""
    given = {f"--frames {frames}": frames is not None, f"--run {run}": run is not None, "--driven": driven}
    for option, there in given.items():
        if there:
            raise UserError(f"{option}: {path} is no avatar, it has no avatar.json")


NAMES = {import_capture: "import", body_model: "body-model"}
for command in (align, train, animate, edit, studio, inspect, tune, status, view, import_capture, export, body_model):
    app.command(NAMES.get(command))(spoken(command))
for command in (settings, doctor, completion):  # they log nothing
    app.command()(command)


def main():
    """Entry point with the exit codes of this page."""
    speech.speak()
    if COMPLETE in os.environ:
        completion_init()
    try:
        code = app(standalone_mode=False, prog_name="toile", complete_var=COMPLETE)
        if code == STOPPED:  # typer's answer to Ctrl-C
            raise KeyboardInterrupt
    except (UserError, InputError) as error:
        code = told(str(error), 1)
    except (typer.Abort, KeyboardInterrupt):
        code = told(f"stopped; go on with: {resumed()}" if resumed() else "stopped", STOPPED)
    except (OSError, MemoryError) as error:  # a full disk, a folder that may not be written
        full = getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT) and resumed()
        code = told(first_line(error) + (f"; once there is space, go on with: {resumed()}" if full else ""), 1)
    except Exception as error:
        if hasattr(error, "exit_code") and hasattr(error, "format_message"):  # of the command line's own parser
            command = getattr(error.ctx, "command_path", "toile")
            code = told(f"{error.format_message().rstrip('.')} (see {command} -h)", 1)
        else:
            traceback.print_exc()
            message = f"internal error: {type(error).__name__}: {error}"
            code = told(f"{message}; please report it, with what `toile doctor` says", 3)
    sys.exit(code or 0)


def resumed():
    """This command line, where the same again goes on with what was stopped; "" elsewhere."""
    return f"toile {shlex.join(sys.argv[1:])}" if sys.argv[1:] and sys.argv[1] in RESUMED else ""


def told(message, code):
    """The exit code, once the message stands on one line of stderr."""
    if speech.manner.verbose and code == 1:
        traceback.print_exc()
    speech.error(" ".join(message.split())[:LINE], code)
    return code
