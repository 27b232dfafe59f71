"""Rows to points of time against error, a panel a level or kernel, and the front of each panel."""

from collections import defaultdict

import numpy as np

LEAST = {"mrf": 1e-7, "biharmonic": 1e-13, "untangle": 1e-3}  # errors that a log axis can still show
UNITS = {"register": "mean error [mm]", "sequence": "mean error [mm]", "biharmonic": "relative error",
         "mrf": "energy above the least", "untangle": "lacking of the margin [mm]"}  # fmt: skip


def summarise(rows):
    """{panel: {"kernel", "error", "points": [point]}}, points in order of time; failures are counted, not averaged.
    Cloth that still meets the body is a failure.

    point: method, ours, oracle, seconds, error (means over the panel's problems), worst (largest error), hand_max,
    peak_mb, problems, failed, on_front. Seconds are preparation + solve for pairs, a prepared frame for sequences;
    where preparation counts otherwise, the method appears twice, as "NAME" (both) and "NAME, prepared".
    """
    rows = with_excess_energy(rows)
    panels = defaultdict(lambda: defaultdict(list))
    for row in rows:
        panels[row["kernel"], row["panel"]][row["method"]].append(row)
    out = {}
    for (kernel, panel), by_method in panels.items():
        points = [p for method, group in by_method.items() for p in points_of(kernel, method, group)]
        mark_front(points)
        points.sort(key=lambda p: p["seconds"] or np.inf)
        unit = "distance to the shirt [mm]" if panel == "shirt" else UNITS[kernel]
        out[panel] = dict(kernel=kernel, error=unit, points=points)
    return out


def with_excess_energy(rows):
    """MRF rows with error = energy / least energy of the problem - 1."""
    least = {}
    for r in rows:
        if "energy" in r:
            least[r["problem"]] = min(r["energy"], least.get(r["problem"], np.inf))
    return [r | dict(error=r["energy"] / least[r["problem"]] - 1) if "energy" in r else r for r in rows]


def error_of(kernel, row):
    distance = "surf" if row["panel"] == "shirt" else "mean"
    return row.get({"mrf": "error", "biharmonic": "error", "untangle": "worst_mm"}.get(kernel, distance))


def points_of(kernel, method, group):
    good = [r for r in group if isinstance(error_of(kernel, r), float | int) and not r.get("pairs")]
    timed = good or [r for r in group if kernel == "biharmonic" and "solve_s" in r]
    base = dict(method=method, ours=group[0]["ours"], oracle=group[0]["oracle"], on_front=False)
    base |= dict(problems=len(group), failed=len(group) - len(timed))
    if not timed:
        return [base | dict(seconds=None, error=None, why=group[0].get("error"))]
    errors = [max(error_of(kernel, r), LEAST.get(kernel, 0)) for r in good]
    mean = lambda values: float(np.mean(values)) if len(values) else None
    hands = [r.get("worst_hand_max", r.get("hand_max")) for r in good if "hand_max" in r]
    base |= dict(error=mean(errors), worst=max(errors, default=None), hand_max=max(hands, default=None),
                 peak_mb=max(r["peak_mb"] for r in timed), process_s=mean([r["process_s"] for r in timed]))  # fmt: skip
    prepare, solve = mean([r["prepare_s"] for r in timed]), mean([r["solve_s"] for r in timed])
    if kernel == "sequence":
        return [base | dict(seconds=solve, prepare_s=prepare)]
    if kernel == "register" or prepare < 0.1 * solve:
        return [base | dict(seconds=prepare + solve, prepare_s=prepare)]
    return [base | dict(seconds=prepare + solve), base | dict(method=f"{method}, prepared", seconds=solve)]


def mark_front(points):
    """A point is on the front when no other is both faster and better; oracles do not compete."""
    racing = [p for p in points if p["seconds"] and p["error"] is not None and not p["oracle"] and not p["failed"]]
    best = np.inf
    for p in sorted(racing, key=lambda p: (p["seconds"], p["error"])):
        p["on_front"] = p["error"] < best
        best = min(best, p["error"])
