"""Frames a second of an avatar: decoding, ambient occlusion with its shadows, drawing.   python -m bench.avatar_speed AVATAR

One frame and camera after another, as a viewer would; medians. The sample is a picture of the avatar's own run, its
window scaled to --size, so that the person fills the picture as in training. --workers 2: as `toile animate --workers 2` makes
a film, each process a frame of its own; frames a second are those of all together.
"""

import argparse
import json
import statistics
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import torch

REPEAT = 15


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("avatar", type=Path)
    parser.add_argument("--size", type=int, default=512, help="height and width of the picture [px]")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument(
        "--workers", type=int, default=1, help="processes that draw at the same time, each with --threads"
    )
    parser.add_argument("--run", type=Path, help="its run, if that was moved")
    a = parser.parse_args()
    with get_context("spawn").Manager() as manager, ProcessPoolExecutor(a.workers, get_context("spawn")) as pool:
        together = manager.Barrier(a.workers)
        asked = [pool.submit(measure, a.avatar, a.size, a.threads, a.run, together) for _ in range(a.workers)]
        each = [one.result() for one in asked]
    sums = {key: sum(one[key] for one in each) for key in each[0] if key.startswith("frames")}
    print(json.dumps(each[0] | {"workers": a.workers} | sums, indent=1))


def measure(folder, size, threads, run=None, together=None):
    from torch.utils.data import default_collate

    from toile import kernels
    from toile.avatar.measure.heldout import HeldOut
    from toile.avatar.model.checkpoint import read_facts
    from toile.avatar.model.recorded import decoder

    torch.set_num_threads(threads)
    kernels.set_threads(threads)
    held = HeldOut(folder, read_facts(folder)["frames"][:1], run)
    name, data = next(iter(held.data.items()))
    avatar, sample = held.avatars[name], data[0]
    decode = decoder(avatar)
    scale = torch.tensor([[size / sample["image"].shape[-1]], [size / sample["image"].shape[-2]], [1.0]])
    batch = {k: v.to(held.device) for k, v in default_collate([sample | {"K": sample["K"] * scale}]).items()}
    with torch.no_grad():
        latents = avatar.means(avatar.encode(batch))
        decoded = decode(batch, latents)
        occlusion = avatar.ambient_occlusion(decoded)
        calls = {
            "decode": lambda: decode(batch, latents),
            "occlusion": lambda: avatar.ambient_occlusion(decoded),
            "shadow": lambda: avatar.shade(decoded, occlusion),
            "draw": lambda: avatar.compose(decoded, batch, (size, size), shadow=False),
        }
        parts = {name: median(call, together) for name, call in calls.items()}
    plain = parts["decode"] + parts["draw"]
    shadowed = plain + parts["occlusion"] + parts["shadow"]
    return {
        "size": size, "device": str(held.device), "threads": threads, "rays": avatar.settings.network.ao_rays,
        "seconds": parts, "frames_per_second": 1 / plain, "frames_per_second_with_occlusion": 1 / shadowed,
    }  # fmt: skip


def median(call, together):
    """Median seconds of a call, after one that warms up; processes begin it `together`, at a barrier."""
    times = []
    if together is not None:
        together.wait()
    for _ in range(REPEAT + 1):
        synchronise()
        start = time.perf_counter()
        call()
        synchronise()
        times.append(time.perf_counter() - start)
    return statistics.median(times[1:])


def synchronise():
    if torch.cuda.is_available():
        torch.cuda.synchronize()


if __name__ == "__main__":
    main()
