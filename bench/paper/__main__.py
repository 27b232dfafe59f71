"""The paper's comparisons by one command that goes on where it stood; the page is OUT/index.html.

python -m bench.paper OUT [CAPTURE...] --minutes 60 --holdout 1020-1199 --seeds 0,1,2 --ablate avatar_logo --set lr=1e-3
"""

import argparse
import json
from pathlib import Path

from toile.avatar.settings import AvatarSettings, DataSettings, NetworkSettings, TemporalSettings, preset
from toile.console import progress_bars
from toile.kernels import set_threads

from .captures import SUBJECTS, Captures
from .made import machine
from .study import Paper

ROOT = Path(__file__).parents[2]
TABLE = {  # asked without a capture: docs/measurements/avatars.md says what is equal
    "simulated": 960, "image_step": 6, "registration": "draft", "quality": "draft", "holdout": "768-959", "align": "all", "window": 3,
    "set": ['data.crop="garment"', "data.image=[224,224]", "body_steps=300", "garment_steps=300", "joint_steps=1000"],
}  # fmt: skip
TINY = AvatarSettings(
    quality="small", data=DataSettings(geometry_size=64, texture_size=64, image=(96, 96)), lr=3e-3,
    network=NetworkSettings(latent=8, width=8, least_width=4, ao_rays=4, ao_size=32),
    body_steps=20, garment_steps=20, joint_steps=20, baseline_lr=(1.0,),
)  # fmt: skip


def arguments(words=None):
    """Of these words, or of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument(
        "captures",
        type=Path,
        nargs="*",
        help=f"or runs; default: {', '.join(SUBJECTS)}, made by the studio, and {TABLE}",
    )
    parser.add_argument(
        "--small",
        action="store_true",
        help="the bundled capture and tiny networks, in OUT/small: minutes, to see that it runs",
    )
    parser.add_argument("--seeds", default="0", help="separated by commas")
    parser.add_argument("--registration", default="standard", help="quality of `toile register`")
    parser.add_argument("--frames", help="of each capture: 1-50,60")
    parser.add_argument("--quality", default="standard", help="of the avatar: draft, standard, fine")
    parser.add_argument("--minutes", type=float, help="of each layered training; all others take as many steps")
    parser.add_argument("--holdout", help="A-B, frames never trained on; default the last tenth")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting: network.latent=64")
    parser.add_argument("--temporal-steps", type=int, default=TemporalSettings().steps)
    parser.add_argument("--window", type=int, default=15, help="poses that drive the garments")
    parser.add_argument(
        "--align", default="none", choices=("none", "ablation", "all"), help="runs that `toile align` aligns"
    )
    parser.add_argument(
        "--ablate", help="the capture that is ablated, by name; none: no ablations; default the second of several"
    )
    parser.add_argument("--ablation-steps", help="BODY,GARMENT,JOINT; default as many as the full avatar took")
    parser.add_argument("--windows", default="1,3,8,15,30", help="lengths L of the ablation")
    parser.add_argument("--qualities", default="", help="presets that are compared: draft,standard,fine")
    parser.add_argument("--quality-minutes", type=float, default=30.0, help="of each of them")
    parser.add_argument("--workers", type=int, default=1, help="processes that register, or make captures")
    parser.add_argument("--threads", type=int, help="of this process")
    parser.add_argument("--simulated", type=int, default=400, help="frames of a capture to make, 30 a second")
    parser.add_argument("--image-step", type=int, default=4, help="every which of them is pictured")
    parser.add_argument("--cameras", type=int, default=8)
    parser.add_argument("--size", type=int, default=512, help="of its pictures [px]")
    parser.add_argument("--motion", default="talk")
    parser.add_argument(
        "--renderer", default="raster", choices=("raster", "mitsuba"), help="mitsuba traces paths: days"
    )
    found = parser.parse_args(words)
    if found.captures or found.small:
        return found
    parser.set_defaults(**TABLE)
    asked = parser.parse_args(words)
    asked.set = [*TABLE["set"], *found.set]
    return asked


def main():
    a = arguments()
    if a.threads:
        import torch

        torch.set_num_threads(a.threads)
        set_threads(a.threads)
    with progress_bars() as progress:
        stages = lambda stage, done, total, note="": progress(stage, done, total)
        say = lambda text: print(text, flush=True)
        print(run(a, say, stages), machine())


def run(a, say, progress):
    """The page of what the arguments ask for."""
    if a.small:
        return small(a.out / "small", say, progress).run()
    if a.captures:
        return asked(a, tuple(a.captures), say, progress).run()
    with Captures(a.out, of_studio(a), a.workers, say) as captures:
        return asked(a, captures.folders, say, progress, captures.ready).run()


def small(out, say, progress):
    capture = ROOT / "data_samples" / "tshirt-talk"
    return Paper(
        out, (capture,), (0,), TINY, TemporalSettings(window=3, channels=16, steps=50), "draft", holdout="3-5", align="ablation",
        ablated=capture.name, windows=(1, 2), say=say, progress=progress,
    )  # fmt: skip


def asked(a, captures, say, progress, ready=lambda capture: None):
    names = [capture.name for capture in captures]
    ablated = a.ablate or (names[1] if len(names) > 1 else None)
    return Paper(
        a.out, captures, numbers(a.seeds), with_values(preset(a.quality), a.set),
        TemporalSettings(window=a.window, steps=a.temporal_steps), a.registration, a.frames, a.holdout, a.minutes, a.align,
        ablated, numbers(a.ablation_steps) or None, numbers(a.windows), tuple(filter(None, a.qualities.split(","))),
        a.quality_minutes, a.workers, say, progress, ready,
    )  # fmt: skip


def of_studio(a):
    """StudioOptions of a capture of the study, by name."""
    return {
        "frames": a.simulated, "image_step": a.image_step, "cameras": a.cameras, "size": a.size, "motion": a.motion,
        "renderer": a.renderer, "pairs": 40,
    }  # fmt: skip


def numbers(text):
    return tuple(int(n) for n in (text or "").split(",") if n)


def with_values(settings, assignments):
    """Settings with NAME=VALUE replaced; VALUE is JSON or a word."""
    values = settings.model_dump()
    for text in assignments:
        name, _, value = text.partition("=")
        *path, last = name.split(".")
        place = values
        for part in path:
            place = place[part]
        try:
            place[last] = json.loads(value)
        except json.JSONDecodeError:
            place[last] = value
    return AvatarSettings(**values)


if __name__ == "__main__":
    main()
