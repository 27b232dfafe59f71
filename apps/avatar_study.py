"""Layered avatars against the single layer on captures and seeds: registers, trains, evaluates; goes on where it stood.

    python -m apps.avatar_study OUT CAPTURE... --seeds 0,1,2 --holdout 2040-2399 --minutes 60 --set data.crop=garment
"""

import argparse
import json
from pathlib import Path

from bench.avatar import Study, table
from toile.avatar.settings import AvatarSettings, preset
from toile.cli import progress_bars


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("--seeds", default="0", help="separated by commas")
    parser.add_argument("--registration", default="standard", help="quality of `toile register`")
    parser.add_argument("--frames", help="of each capture: 1-50,60")
    parser.add_argument("--quality", default="standard", help="of the avatar: draft, standard, fine")
    parser.add_argument("--minutes", type=float, help="of each layered training")
    parser.add_argument("--holdout", help="A-B, frames never trained on; default the last tenth")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting: network.latent=64")
    a = parser.parse_args()
    study = Study(
        a.out, tuple(a.captures), tuple(int(s) for s in a.seeds.split(",")), changed(preset(a.quality), a.set),
        a.registration, a.frames, a.holdout, a.minutes,
    )  # fmt: skip
    a.out.mkdir(parents=True, exist_ok=True)
    with progress_bars() as progress:
        study.run(lambda text: print(text, flush=True), progress)
    print(table(a.out))


def changed(settings, assignments):
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
