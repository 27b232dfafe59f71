"""The commands `toile train`, `toile animate` and `toile edit`."""

from __future__ import annotations

import os
import re
from functools import partial
from pathlib import Path
from typing import Annotated, get_args

import numpy as np
import typer

from .. import speech
from ..console import SEEDS, Apart, Changes, ConfigFile, Garments, Scheduler, Workers
from ..errors import UserError


def train(
    run: Annotated[Path, typer.Argument(help="a registered run, made by toile register")],
    avatar: Annotated[Path, typer.Argument(help="folder of the avatar; a training that was stopped there goes on")],
    quality: Annotated[
        str | None, typer.Option(help="draft, standard (the default) or fine: sizes of the maps, widths, steps")
    ] = None,
    minutes: Annotated[
        float | None, typer.Option(help="as many steps as fit, aligning apart; without, the quality's")
    ] = None,
    steps: Annotated[str | None, typer.Option(help="BODY,GARMENT,JOINT: steps of each phase")] = None,
    holdout: Annotated[
        str | None,
        typer.Option(
            metavar="A-B", help="frames never trained on; default those of the run, else the last tenth; none"
        ),
    ] = None,
    baseline: Annotated[bool, typer.Option("--baseline", help="also the single-layer avatar to compare with")] = False,
    align: Annotated[
        bool | None,
        typer.Option(
            "--align/--no-align",
            help="in AVATAR/aligned garments slide until their prints lie still, and that is learnt; default of a run that is not aligned",
        ),
    ] = None,
    temporal: Annotated[
        bool, typer.Option("--temporal", help="also the model that drives the garments by poses")
    ] = False,
    temporal_model: Annotated[
        str | None, typer.Option(help="of --temporal: window (the default), or damped, a state of its own")
    ] = None,
    physics: Annotated[
        bool, typer.Option(help="of --temporal: garments are measured as cloth too, and hang where that is nearer")
    ] = True,
    window: Annotated[
        int | None, typer.Option(help="poses that the window model sees; default half a second of them")
    ] = None,
    lr: Annotated[float | None, typer.Option(help="learning rate of AdamW; default the quality's")] = None,
    seed: Annotated[
        int | None, typer.Option(help="same seed, same avatar on the same CPU; default 0", min=0, max=SEEDS - 1)
    ] = None,
    config: ConfigFile = None,
    changes: Changes = None,
):
    """Train an avatar on a registered run and its pictures. On several GPUs: torchrun --no-python -m ... toile train.

    Of an avatar that is there, what is not given stays as it was asked: settings and hold-out.
    """
    from ..config import changed, from_options
    from ..console import progress_bars
    from .drive.driver import FILE, taught_before
    from .model.checkpoint import asked_before
    from .settings import TemporalSettings, TrainSettings, train_preset

    if not (temporal or temporal_model) and (window is not None or not physics):
        given = "--no-physics" if window is None else f"--window {window}"
        raise UserError(f"{given}: it is of what drives garments: give --temporal too")
    own = own_options(minutes, steps, lr, seed) | {"temporal": temporal_options(temporal_model, window, seed)}
    trained = asked_before(avatar).get("settings")
    named = quality or config or any(word.startswith("quality") for word in changes or ())
    taught = taught_before(avatar)
    if temporal and taught is None and (avatar / FILE).exists():
        speech.warn(
            f"{avatar / FILE}: does not say how it was taught: it is taught anew by defaults and by what is given"
        )
    taught = taught or TemporalSettings()
    as_before = lambda _: TrainSettings(**trained.model_dump(), temporal=taught)
    base = train_preset if trained is None or named else as_before
    asked = changed(from_options(base, quality, config, changes), own)
    settings, drive = asked.avatar(), asked.temporal if temporal or temporal_model else None
    from .train.make import Request, make_avatar

    first = os.environ.get("RANK", "0") == "0"  # of torchrun's processes
    with progress_bars(quiet=not first) as progress:
        still = partial(laid_still, asked=align, progress=progress)
        request = Request(run, settings, minutes, holdout, progress, progress.print, still, speech.warn)
        make_avatar(request, avatar, baseline)
        if drive and first:
            from .drive.draping import forget_cloths
            from .drive.driver import hardly_foretold
            from .drive.teaching import train_temporal

            measured = train_temporal(avatar, drive, lambda *at: progress("temporal", *at))
            if (avatar / "baseline" / "avatar.json").exists():
                train_temporal(avatar / "baseline", drive, lambda *at: progress("baseline temporal", *at))
            if physics:
                from .drive.cloths import ensure_cloths

                ensure_cloths(avatar, progress=progress)
            else:
                forget_cloths(avatar)
    if first:
        if drive:
            speech.result(temporal_words(drive.model, measured), **measured)
            for words in hardly_foretold(measured):
                speech.warn(words)
            if physics:
                say_cloths(avatar)
        speech.result(f"{avatar}: trained", avatar=avatar)
        speech.next_step("evaluate", avatar)


def temporal_words(model, measured):
    """What is said of a temporal model of this kind, by what its training measured."""
    said = [f"{measured['steps']} steps"]
    said += [
        f"{name.replace('_', ' ')} {measured[name]:.3f}" for name in ("code_error", "held_out") if name in measured
    ]
    kriged = f", {measured['kriged_share']:.2f} kriged" if "kriged_share" in measured else ""
    said += ["of the codes' variance"] * (len(said) > 1)
    return f"temporal model ({model}{kriged}): {', '.join(said)}"


def laid_still(run, folder, asked, progress):
    """The Run that AVATAR `folder` learns: `run`, or AVATAR/aligned made of it, see `toile align`. `asked` None: as the avatar that is
    there was; a new one learns an aligned run, unless this one is, or torchrun trains it. UserError: AVATAR learnt that of another run."""
    from ..align.run import align
    from ..io.registration import registration
    from ..io.run import is_run, open_run
    from .model.checkpoint import ALIGNED, asked_before

    own, before = (Path(folder) / ALIGNED).resolve(), asked_before(folder).get("run")
    together = int(os.environ.get("WORLD_SIZE", 1)) > 1
    if asked is None and before is not None:
        asked = before == str(own)
    if asked is None:
        printed = any(garment.prints for garment in run.capture.scene.garments)
        asked = bool(run.garments) and not (together or printed or "align" in run.config)
    if not asked or run.path.resolve() == own:
        return run
    if before not in (None, str(own)):
        raise UserError(f"--align: {folder} was trained on {before} as it is: take another folder")
    if before == str(own) and is_run(own):
        learnt = open_run(own)
        of = learnt.config.get("align", {})
        elsewhere = of.get("run") != str(run.path.resolve())
        if elsewhere and not same_poses(learnt, run):  # a run that was moved has them still
            raise UserError(f"{own}: was aligned from {of.get('run')}, asked is {run.path}: take another folder")
        digest = lambda one: registration(one, one.ok, one.garments.values())
        if of.get("registration", now := digest(run)) != now and digest(learnt) != now:  # nor is it a copy of that run
            raise UserError(
                f"{own}: was aligned from another registration than that of {run.path}: take another folder"
            )
        return learnt
    if together:
        raise UserError(f"--align: not by torchrun: toile align {run.path} ALIGNED, then train on that")
    done = align(run.path, own, progress=lambda stage, done, total: progress(f"align: {stage}", done, total))
    for warning in done.warnings:
        speech.warn(warning)
    speech.frame_notes({"failed": done.failed})
    return open_run(own)


def same_poses(one, other):
    """Whether two Runs have the same poses in the same frames, to the bit, NaN where a frame failed: aligning keeps them."""
    kept = lambda run: (run.frames, run.pose.rotations[:], run.pose.translation[:])
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(kept(one), kept(other)))


def say_cloths(avatar):
    """A line a garment: what drives it from now on, and why."""
    from .drive.draping import load_cloths
    from .drive.residual import CODES
    from .model.checkpoint import load_avatar

    for name, cloth in load_cloths(avatar, load_avatar(avatar).layers).items():
        missed = {of: 1e3 * value for of, value in cloth.residual.missed.items()}
        if CODES not in missed:
            words = f"{name}: codes drive it: too few frames to leave some out and see how it hangs"
            speech.result(words, garment=name, as_cloth=False)
        else:
            driver = "it hangs as cloth" if cloth.helps else "codes drive it"
            off = ", ".join(f"{of} {value:.1f}" for of, value in missed.items())
            words = f"{name}: {driver} when it is driven; off in training frames left out [mm]: {off}"
            speech.result(words, garment=name, as_cloth=cloth.helps, missed_mm=missed)


def animate(
    avatar: Annotated[Path, typer.Argument(help="made by toile train --temporal, or its baseline/")],
    motion: Annotated[
        Path, typer.Argument(help="a run, a .bvh file, or an .npz: toile's own, or of AMASS (SMPL, SMPL-H, SMPL-X)")
    ],
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
    physics: Annotated[
        bool | None,
        typer.Option(
            "--physics/--no-physics",
            help="garments hang as cloth on the body, or none does; default those that are nearer so",
        ),
    ] = None,
    garment: Garments = None,
    apart: Apart = True,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    config: ConfigFile = None,
    changes: Changes = None,
):
    """Drive an avatar by a motion: pictures, meshes and a film, every garment out of the body."""
    from ..config import from_options
    from ..console import garments_of, numbers_of, progress_bars
    from .drive.animate import animate as run_animation
    from .drive.animate import check_asked
    from .settings import AnimateSettings

    settings = from_options(lambda _: AnimateSettings(), None, config, changes)
    if (config or changes) and not physics:
        raise UserError("--set, --config: they are of cloth: give --physics too")
    garments, numbers = garments_of(garment), numbers_of(frames)
    with progress_bars() as progress:
        if physics:
            from .drive.cloths import ensure_worn

            check_asked(avatar, motion, numbers, camera, height, garments)
            ensure_worn(avatar, garments, progress, settings.cloth)
        options = dict(seed=seed, progress=progress, workers=workers, scheduler=scheduler, physics=physics)
        options |= dict(garments=garments, apart=apart)
        done = run_animation(avatar, motion, out, numbers, camera, height, meshes, **options)
    for warning in done.warnings:
        speech.warn(warning)
    say_limbs(done.limbs, done.frames)
    before, left = done.intersections_before, done.intersections_left
    words = f"{out}: {done.frames} frames; pairs of garments and what lies under them that intersect: {before} as decoded, {left} left"
    words += f"; skin gave way to cloth without room by up to {1e3 * done.dent:.1f} mm" if done.dent else ""
    speech.result(words, intersections_before=before, intersections_left=left, dent=done.dent)
    if done.hung:
        speech.result(f"as cloth: {', '.join(done.hung)}", as_cloth=list(done.hung))
    speech.next_step("view", out)


def say_limbs(facts, frames):
    """One line of what keeping limbs apart changed; none where there was nothing to keep apart."""
    if not facts or not facts["frames_changed"]:
        return
    words = f"limbs kept apart: {facts['frames_changed']} of {frames} frames changed, by up to {facts['largest_turn_deg']} degrees"
    before, left = facts["pairs_before"], facts["pairs_left"]
    words += (
        f"; {before} intersecting pairs of limbs with the body, {left} left"
        if before
        else ", for garments over one another"
    )
    speech.result(words + (f" in {facts['frames_left']} frames" if left else ""), limbs=facts)


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
    from ..console import numbers_of, progress_bars
    from .edit.editing import Change
    from .edit.editing import edit as run_edit

    change = Change(garment, scale, checker, image, text, at, size)
    with progress_bars() as progress:
        done = run_edit(avatar, out, change, numbers_of(frames), run, sheet, progress)
    speech.result(f"{out}: {garment}: {done.words}{', and its baseline' if done.baseline else ''}")
    for name in ("layered", "baseline") if done.measured else ():
        found = done.measured[name]
        if found and found["border_mm"] is not None:
            border, area = found["border_mm"], found["area_share"]
            words = f"{name}: border {border:.1f} mm off, area {100 * area:.1f} % off"
            speech.result(words, avatar=name, border_mm=border, area_share=area)
    speech.next_step("view", out)


def temporal_options(model, window, seed):
    """What options of their own change of TemporalSettings; UserError names the option."""
    from .settings import TemporalSettings

    models = get_args(TemporalSettings.model_fields["model"].annotation)
    if model not in (None, *models):
        raise UserError(f"--temporal-model {model}: expected {' or '.join(models)}")
    if window is not None and not 1 <= window <= 10_000:
        raise UserError(f"--window {window}: expected at least one pose")
    given = {"model": model, "window": window, "seed": seed}
    return {name: value for name, value in given.items() if value is not None}


def own_options(minutes, steps, lr, seed):
    """Settings that options of their own change, above --set; UserError names the option."""
    changed = {} if seed is None else {"seed": seed}
    if minutes is not None and not 0 < minutes < 1e6:
        raise UserError(f"--minutes {minutes:g}: expected a positive number")
    if lr is not None:
        if not 0 < lr < 1:
            raise UserError(f"--lr {lr:g}: expected a number between 0 and 1")
        changed["lr"] = lr
    if steps is not None:
        counts = steps.split(",")
        if len(counts) != 3 or not all(re.fullmatch(r"[0-9]{1,9}", count.strip()) for count in counts):
            raise UserError(f"--steps {steps}: expected three numbers BODY,GARMENT,JOINT")
        if minutes is not None:
            raise UserError(f"--steps {steps}: --minutes {minutes:g} is given too")
        if not any(map(int, counts)):
            raise UserError(f"--steps {steps}: nothing would be trained")
        changed |= dict(zip(("body_steps", "garment_steps", "joint_steps"), map(int, counts)))
    return changed
