"""The rows of a run against the goals of `nricp`, each figure the worst of the seeds.

python -m bench.goals tradeoff/rows.jsonl

S1 is what a throwaway prototype reached on its own tuning seed: the error that `standard` must not exceed. Times are
ratios to trimesh's `nricp_amberg` on the same problem in the same run (of pairs, also for the frames of a sequence).
"""

import json
import sys
from collections import defaultdict

S1 = {  # mean error [mm]
    "L1_clean": 0.73, "L2_clean": 0.86, "L3_clean": 1.52, "L4_clean": 1.11,
    "L1_noise1": 0.91, "L2_noise1": 1.08, "L3_noise1": 1.77, "L4_noise1": 1.93,
    "L1_noise3": 2.26, "L2_noise3": 2.88, "L3_noise3": 2.64, "L4_noise3": 3.58,
}  # fmt: skip
FLOORS = {  # what the prototype left when it was started at the truth [mm]; `fine` is to close half of the gap to it
    "L1_clean": 0.36, "L2_clean": 0.36, "L3_clean": 0.40, "L4_clean": 0.37,
    "L1_noise1": 0.59, "L2_noise1": 0.70, "L3_noise1": 0.77, "L4_noise1": 0.86,
    "L1_noise3": 0.90, "L2_noise3": 1.36, "L3_noise3": 1.76, "L4_noise3": 1.82,
}  # fmt: skip
LARGE = {"L5_clean": 5.0, "L5_noise1": 5.0, "L5_noise3": 8.0}  # mean error [mm]
PAIR, FRAME, DRAFT_FRAME = 0.02, 0.006, 0.0025  # of trimesh's time
PEER, FLOOR = "trimesh amberg", "floor: toile fine from the truth"


def index(rows):
    """{(problem, method): [row of each seed]}"""
    found = defaultdict(list)
    for row in rows:
        found[row["problem"], row["method"]].append(row)
    return found


def worst(rows, key):
    values = [r.get(key) for r in rows]
    return max(values) if values and all(isinstance(v, float | int) for v in values) else float("nan")


def seconds(row):
    return row["prepare_s"] + row["solve_s"] if "solve_s" in row else float("nan")


def time_ratio(found, problem, method):
    """Slowest time of a pair over trimesh's mean on that problem (of level 2, where it did not run on that)."""
    peer = [seconds(r) for r in found[problem, PEER] or found["L2_noise1" + problem[problem.rfind("_") :], PEER]]
    if not peer:
        return float("nan")
    return max((seconds(r) for r in found[problem, method]), default=float("nan")) * len(peer) / sum(peer)


def pairs(found):
    heads = ["", "S1", "standard", "half-way", "fine", "fine from the truth", "draft", "draft, hand max", "trimesh",
             "time draft", "time standard (0.02)", "time fine"]  # fmt: skip
    yield " | ".join(["", *heads, ""]).strip()
    yield "|" + "---|" * len(heads)
    for name, goal in S1.items():
        names = ("toile draft", "toile standard", "toile fine", FLOOR, PEER)
        draft, standard, fine, floor, peer = (worst(found[name, m], "mean") for m in names)
        hand = worst(found[name, "toile draft"], "hand_max")
        cells = [goal, standard, (goal + FLOORS[name]) / 2, fine, floor, draft, hand, peer]
        ratios = [time_ratio(found, name, f"toile {p}") for p in ("draft", "standard", "fine")]
        yield " | ".join(["", name, *(f"{c:.2f}" for c in cells), *(f"{r:.4f}" for r in ratios), ""]).strip()


def others(found):
    for name, goal in LARGE.items():
        for preset in ("draft", "standard", "fine"):
            by_start = {s: worst(found[name, f"toile {preset} + {s}"], "mean") for s in ("landmarks", "skeleton")}
            yield f"{name} {preset}: " + ", ".join(f"{s} {e:.2f}" for s, e in by_start.items()) + f" mm (goal {goal})"
    for level in (1, 3):
        peer = [seconds(r) for r in found[f"L{level}_noise1", PEER]]
        for preset, goal in (("draft", DRAFT_FRAME), ("standard", FRAME), ("fine", float("nan"))):
            rows = found[f"seq_L{level}", f"toile {preset}"]
            if rows and peer:
                ratio = worst(rows, "solve_s") / (sum(peer) / len(peer))
                yield (f"sequence level {level} {preset}: {1e3 * worst(rows, 'solve_s'):.0f} ms a frame = {ratio:.4f} "
                       f"x trimesh (goal {goal}), mean {worst(rows, 'mean'):.2f} mm, "
                       f"worst frame {worst(rows, 'worst_mean'):.2f}, hand {worst(rows, 'worst_hand_max'):.1f}, "
                       f"{worst(rows, 'peak_mb'):.0f} MB")  # fmt: skip
    for (name, method), rows in sorted(found.items()):
        if name.endswith(("src53k", "tgt100k", "full")) and method.startswith("toile"):
            ratio = time_ratio(found, name, method)
            yield (f"{name} {method}: {worst(rows, 'mean'):.2f} mm, {ratio:.4f} x trimesh (goal 0.015 at 53k), "
                   f"{worst(rows, 'peak_mb'):.0f} MB (goals 400 at 53k, 300 at 14k/100k), "
                   f"{worst(rows, 'flips')} flips, {worst(rows, 'degenerate')} degenerate, "
                   f"hidden vertices {worst(rows, 'hidden_max'):.1f} mm")  # fmt: skip


def main():
    with open(sys.argv[1]) as file:
        found = index([json.loads(line) for line in file])
    print("\n".join([*pairs(found), "", *others(found)]))


if __name__ == "__main__":
    main()
