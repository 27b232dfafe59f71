"""The commands `toile detect` and `toile reconstruct`: what pictures show."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ... import speech
from ...console import Changes, ConfigFile, Frames, Scheduler, Step, Workers, frame_numbers, progress_bars
from ...errors import UserError


def detect(
    capture: Path,
    detector: Annotated[
        str | None, typer.Option(help="a program: COMMAND PICTURES OUT [PICTURES OUT ...], run without a shell")
    ] = None,
    model: Annotated[Path | None, typer.Option(help="a network of keypoints, an ONNX file")] = None,
    labels: Annotated[
        Path | None,
        typer.Option(
            help="label images instead, labels/CAMERA.png, by a network of labels: clothes, which is packaged, or an ONNX file"
        ),
    ] = None,
    frames: Frames = None,
    again: Annotated[
        bool, typer.Option("--again", help="also frames that have keypoints.json, or label images")
    ] = False,
    workers: Workers = 1,
    scheduler: Scheduler = None,
):
    """Find keypoints and masks of the person in a capture's pictures: keypoints.json and masks/ of each frame.

    Without --detector and --model by the network that scene.toml names, else by mediapipe, which `make detector` sets up.
    """
    from ...io.capture import open_capture
    from ...io.scene_file import SEGMENTERS
    from ..detect import detect as find

    opened = open_capture(capture)
    numbers = frame_numbers(frames, opened.frames)
    if labels is not None:
        if detector is not None or model is not None:
            raise UserError("--labels: --detector or --model is given too")
        return write_label_images(opened, SEGMENTERS.get(str(labels), labels), numbers, again, workers, scheduler)
    with progress_bars() as progress:
        found = find(opened, detector_of(opened, detector, model), numbers, again, progress, workers, scheduler)
    kept = f", {len(found.kept)} had theirs (--again makes them anew)" if found.kept else ""
    speech.result(f"{capture}: keypoints in {len(found.written)} frames{kept}", written=found.written, kept=found.kept)
    for warning in found.warnings:
        speech.warn(warning)
    speech.next_step("inspect", capture)


def write_label_images(capture, network, numbers, again, workers, scheduler):
    """What `toile detect --labels` does."""
    from ..labelling import write_labels

    with progress_bars() as progress:
        done = write_labels(capture, network, numbers, again, progress, workers, scheduler)
    kept = f", {done.kept} were there (--again makes them anew)" if done.kept else ""
    speech.result(f"{capture.root}: {done.written} label images{kept}", written=done.written, kept=done.kept)
    if done.written:
        speech.result(f"  of the person's pixels {100 * done.unsure:.1f} % are unsure", unsure=done.unsure)
    if done.taken:
        speech.warn(done.taken)
    speech.next_step("inspect", capture.root)


def detector_of(capture, command, model):
    """The detector that was asked for; one of --detector, --model, scene.toml's network, mediapipe."""
    from ...vision.detectors.network import Network
    from ...vision.detectors.program import Program, default_python, its_own

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


def reconstruct(
    capture: Path,
    out: Annotated[Path, typer.Argument(help="a new capture: all of CAPTURE, and scans; goes on with what is there")],
    quality: Annotated[str | None, typer.Option(help="draft, standard (the default) or fine")] = None,
    frames: Frames = None,
    step: Step = 1,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    config: ConfigFile = None,
    changes: Changes = None,
):
    """Make scans and 3D keypoints of a capture's pictures and masks: scan.ply and keypoints3d.json of each frame."""
    from ...config import from_options
    from ...config.stereo import scan_preset
    from ...io.capture import open_capture
    from ..reconstruct import reconstruct as run_stereo

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
