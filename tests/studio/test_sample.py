"""The bundled captures are whole, small, and what their README says."""

import hashlib
from pathlib import Path

import numpy as np

from toile.io.capture import open_capture
from toile.pipeline.scanning import lacks_scan

SAMPLES = Path(__file__).parents[2] / "data_samples"


def test_bundled_captures_match_their_sums_and_stay_under_10_mb():
    sums = (SAMPLES / "SHA256SUMS").read_bytes()
    assert hashlib.sha256(sums).hexdigest() in (SAMPLES / "README.md").read_text()
    listed = dict(line.split("  ")[::-1] for line in sums.decode().splitlines())
    captures = (SAMPLES / "tshirt-talk", SAMPLES / "tshirt-pictures")
    files = {str(p.relative_to(SAMPLES)): p for folder in captures for p in folder.rglob("*") if p.is_file()}
    assert files.keys() == listed.keys()
    assert all(hashlib.sha256(p.read_bytes()).hexdigest() == listed[name] for name, p in files.items())
    assert sum(p.stat().st_size for p in files.values()) < 10e6


def test_the_bundled_pictures_bring_no_scan_and_are_under_2_mb():
    folder = SAMPLES / "tshirt-pictures"
    assert sum(p.stat().st_size for p in folder.rglob("*") if p.is_file()) < 2e6
    assert lacks_scan(open_capture(folder), 0)


def test_bundled_template_lies_on_the_truth_garment_through_the_map():
    import zarr

    truth = zarr.open_group(str(SAMPLES / "tshirt-talk" / "truth" / "truth.zarr"), mode="r")["garment/tshirt"]
    corners = truth["vertices"][0][truth["faces"][:][truth["map_face"][:]]]
    at = np.einsum("gc,gcd->gd", truth["map_bary"][:], corners)
    template = (SAMPLES / "tshirt-talk" / "templates" / "tshirt.obj").read_text().splitlines()
    V = np.array([line.split()[1:] for line in template if line.startswith("v ")], dtype=float)
    F = np.array([[c.split("/")[0] for c in line.split()[1:]] for line in template if line.startswith("f ")], int) - 1
    edge = lambda P: np.linalg.norm(P[F[:, [1, 2, 0]]] - P[F], axis=2)
    ratio = edge(at) / edge(V)
    assert len(V) == len(at) and abs(np.median(ratio) - 1 / 1.03) < 0.03  # worn, over a size off
