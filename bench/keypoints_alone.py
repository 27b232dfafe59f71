"""How far a body tracked by keypoints alone lies from them in the pictures: `python -m bench.keypoints_alone RUN`.

Of all keypoints of a confidence above 0.3, in px: the body's own keypoints; the same beside the offsets of the detector's that the run learnt;
and the points that its cameras agree on, triangulated freely, which no body binds.
"""

import argparse

import numpy as np

import toile
from toile.config import ReconstructSettings
from toile.io.files import load_record
from toile.scene import Person
from toile.stages.reconstruct import triangulate
from toile.surface.keypoints import keypoint_bones

SURE = 0.3  # confidence


def measure(run):
    """{"body" | "body and offsets" | "free": distances (k,) [px]} over all frames and cameras of a run."""
    model, cameras = run.body_model, run.capture.cameras
    person, bones = load_record(run.path / "prepared" / "person.npz", Person), keypoint_bones(model)
    found = {"body": [], "body and offsets": [], "free": []}
    for number in run.ok:
        seen = run.capture.keypoints(number)
        used = [i for i, name in enumerate(seen.names) if name in model.keypoint_names]
        rows = [model.keypoint_names.index(seen.names[i]) for i in used]
        R, x = model.joint_transforms(person.J, *run.pose.at(number))
        own = model.keypoints(run.track.at(number), x)
        beside = (
            own if person.keypoint_offsets is None else own + np.einsum("qij,qj->qi", R[bones], person.keypoint_offsets)
        )
        points = triangulate(seen, cameras, ReconstructSettings()).points[used]
        for name, given in seen.points.items():
            for what, places in zip(found, (own[rows], beside[rows], points)):
                away = np.linalg.norm(cameras[name].project(places)[0] - given[used, :2], axis=1)
                found[what].append(away[(given[used, 2] > SURE) & np.isfinite(away)])
    return {what: np.concatenate(values) for what, values in found.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run")
    for what, away in measure(toile.open_run(parser.parse_args().run)).items():
        print(f"{what}: {away.mean():.1f} px mean, {np.median(away):.1f} median, {len(away)} keypoints")


if __name__ == "__main__":
    main()
