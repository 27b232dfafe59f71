"""evaluate on a run whose errors are known, because it is made of the truth."""

import json
import os
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
import zarr
from PIL import Image

from tests.support.inspected import posed, recalibrated
from tests.support.shapes import tube
from tests.support.synthetic_run import copy_capture, true_run, with_another_template
from toile.io.body import load_body_model
from toile.io.capture import open_capture
from toile.io.facts import facts_of
from toile.io.mesh import read_mesh, write_mesh
from toile.io.status import Status
from toile.measure.evaluate import evaluate
from toile.measure.report import write_report
from toile.measure.truth import Truth
from toile.pipeline.manifest import note_frame
from toile.scene import Mesh


@pytest.fixture
def made(tmp_path):
    capture = copy_capture(tmp_path)
    return capture, true_run(capture, tmp_path)


def test_truth_as_a_run_has_no_error_where_the_measure_is_exact(made):
    all_ = evaluate(made[1])["all"]
    shirt = all_["garment"]["tshirt"]
    assert all_["joint_mm"] < 1e-6
    assert max(shirt[name] for name in ("correspondence_mm", "jitter_mm", "slip_mm", "shared_mm")) < 1e-6
    assert shirt["acceleration"] == pytest.approx(1) and all_["inner"]["acceleration"] == pytest.approx(1, abs=0.01)
    assert all_["inner"]["jitter_mm"] < 0.1
    assert max(shirt["surface_mm"], shirt["observed_p90_mm"], all_["inner"]["observed_p90_mm"]) < 1e-3
    assert len(shirt["boundary_mm"]) == 4 and max(shirt["boundary_mm"].values()) < 5
    assert max(all_["inner"][name] for name in ("hidden_mm", "visible_mm")) < 1e-3
    assert all_["track_to_scan_mm"] < 5
    assert all_["label_iou"]["tshirt"] > 0.9


def test_garment_shifted_by_5_mm_is_5_mm_off_without_jitter(made):
    store = zarr.open_group(str(made[1] / "registered.zarr"), mode="r+")
    store["garment/tshirt/vertices"][:] = store["garment/tshirt/vertices"][:] + np.array([0.005, 0, 0])
    shirt = evaluate(made[1])["all"]["garment"]["tshirt"]
    assert shirt["correspondence_mm"] == pytest.approx(5, abs=1e-6)
    assert shirt["slip_mm"] < 1 < 4 < shirt["shared_mm"] < 5 + 1e-6
    assert 0.5 < shirt["surface_mm"] < 5
    assert shirt["jitter_mm"] < 1e-6


def test_evidence_is_over_every_outside_vertex_and_over_the_whole_scan(made):
    """A hand that left the scan: what was found on the scan is as good as before, the whole surface is not."""
    before = evaluate(made[1])["all"]
    store = zarr.open_group(str(made[1] / "registered.zarr"), mode="r+")
    model = load_body_model("anny")
    hand = model.segments["hand_left"]
    outside = ~model.inside
    vertices, confidence = store["track/vertices"][:], store["confidence/track"][:]
    vertices[:, hand] += np.array([0, 0, 0.4])
    confidence[:, hand] = 0
    store["track/vertices"][:], store["confidence/track"][:] = vertices, confidence
    after = evaluate(made[1])["all"]
    assert after["track_to_scan_mm"] <= before["track_to_scan_mm"] + 0.1
    assert after["fingertip_mm"] - before["fingertip_mm"] == pytest.approx(200, abs=20)  # one hand of two
    assert after["face_mm"] == pytest.approx(before["face_mm"], abs=1e-6) and before["face_mm"] < 1
    moved = outside[hand].sum() / outside.sum()
    far = after["evidence"]["surface_to_scan_mm"]["mean"] - before["evidence"]["surface_to_scan_mm"]["mean"]
    assert 0.1 * 400 * moved < far < 400 * moved
    assert after["evidence"]["scan_to_surface_mm"]["mean"] > before["evidence"]["scan_to_surface_mm"]["mean"] + 0.5
    assert before["evidence"]["observed"] - after["evidence"]["observed"] == pytest.approx(
        moved, abs=0.02
    )  # a cuff may cover some of it
    assert after["evidence"]["silhouette_iou"] < before["evidence"]["silhouette_iou"]


def test_evidence_of_the_truth_is_that_of_the_scans_noise_and_the_detectors(made):
    found = evaluate(made[1])["all"]["evidence"]
    assert found["scan_to_surface_mm"]["mean"] < 6 and found["scan_to_surface_mm"]["p95"] < 30
    assert found["keypoint_px"]["median"] < 12 and found["silhouette_iou"] > 0.85


def test_masks_that_are_empty_although_the_person_is_there_are_left_out_of_silhouettes_and_counted(made):
    before = evaluate(made[1])
    frames = sorted((made[0] / "frames").iterdir())[:2]
    for folder, cameras in zip(frames, (("cam01", "cam02"), ("cam03",))):
        for camera in cameras:
            path = folder / "masks" / f"{camera}.png"
            Image.fromarray(np.zeros_like(np.array(Image.open(path)))).save(path)
    after = evaluate(made[1])
    iou = [found["all"]["evidence"]["silhouette_iou"] for found in (before, after)]
    assert iou[1] == pytest.approx(iou[0], abs=0.01)
    assert not before["warnings"]
    (said,) = after["warnings"]
    assert said == (
        "frames 0-1: masks that are empty although the person is in their pictures, 3 in all, are left out of silhouette_iou"
    )


def test_evidence_needs_no_truth_and_says_what_a_frame_lacks(made):
    shutil.rmtree(made[0] / "truth")
    for kind in ("masks", "images", "labels"):
        for folder in made[0].glob(f"frames/*/{kind}"):
            shutil.rmtree(folder)
    for file in made[0].glob("frames/*/keypoints.json"):
        file.unlink()
    found = evaluate(made[1])["all"]["evidence"]
    assert found["scan_to_surface_mm"]["mean"] > 0 and found["observed"] > 0.5
    assert found["silhouette_iou"] is None and found["keypoint_px"] == {"median": None, "p95": None}


def test_loops_and_hidden_body_are_measured_over_all_their_vertices(made):
    result = evaluate(made[1])["all"]
    shirt, inner = result["garment"]["tshirt"], result["inner"]
    loops = zarr.open_group(str(made[1] / "registered.zarr"), mode="r").attrs["scene"]["garments"][0]["loops"]
    sizes = [len(loops[name]) for name in shirt["boundary_mm"]]
    assert shirt["boundary_all_mm"] == pytest.approx(np.average(list(shirt["boundary_mm"].values()), weights=sizes))
    assert shirt["observed"] == 1 and set(shirt["loop_observed"].values()) == {1}
    assert 0.05 < inner["hidden_share"] < 0.6
    assert inner["hidden_model_mm"] > 3 > inner["hidden_mm"]  # the model of zero shape is another person's


def test_measures_are_null_without_truth(made):
    shutil.rmtree(made[0] / "truth")
    all_ = evaluate(made[1])["all"]
    assert all_["joint_mm"] is None and all_["label_iou"] is None
    shirt = all_["garment"]["tshirt"]
    assert {name for name, value in shirt.items() if value is not None} == {"observed", "loop_observed", "folds"}
    assert all_["track_to_scan_mm"] is not None


def test_frames_beyond_the_truth_leave_the_means_of_the_others(made):
    whole = evaluate(made[1])
    frames = zarr.open_group(str(made[0] / "truth" / "truth.zarr"), mode="r+")["frames"]
    frames[-1] = 1000
    cut = evaluate(made[1])
    assert cut["per_frame"][-1]["label_iou"] is None
    for name in ("label_iou", "inner"):
        known = [f[name] for f in whole["per_frame"][:-1]]
        for key in cut["all"][name].keys() - {"jitter_mm", "acceleration"}:  # of several frames
            value = cut["all"][name][key]
            numbers = [k[key] for k in known if k[key] is not None]
            assert value == (pytest.approx(np.mean(numbers)) if numbers else None)


def test_failed_and_pending_frames_are_left_out(made):
    done = zarr.open_group(str(made[1] / "registered.zarr"), mode="r+")["done"]
    done[0], done[1], done[2] = 2, 0, 0
    result = evaluate(made[1])
    assert len(result["per_frame"]) == done.shape[0] - 3 and result["all"]["frames_failed"] == 1


def test_measures_are_null_where_every_frame_failed(made):
    whole = evaluate(made[1])["all"]
    zarr.open_group(str(made[1] / "registered.zarr"), mode="r+")["done"][:] = 2
    empty = evaluate(made[1])["all"]
    assert empty.keys() == whole.keys() and empty["frames_ok"] == 0
    assert empty["joint_mm"] is None and empty["garment"]["tshirt"].keys() == whole["garment"]["tshirt"].keys()


def test_a_loop_on_another_loops_rim_is_not_on_its_own(made):
    store = zarr.open_group(str(made[1] / "registered.zarr"), mode="r+")
    loops = store.attrs["scene"]["garments"][0]["loops"]
    hem, other = list(loops.values())[:2]
    vertices = store["garment/tshirt/vertices"][:]
    vertices[:, hem] = vertices[:, np.resize(other, len(hem))]
    store["garment/tshirt/vertices"][:] = vertices
    boundary = evaluate(made[1])["all"]["garment"]["tshirt"]["boundary_mm"]
    assert boundary["loop0"] > 100 and boundary["loop1"] < 5


def test_of_a_frame_that_was_given_again_the_last_seconds_count(made):
    status = Status.of(made[1])
    for frame, seconds in ((0, 1.0), (1, 3.0), (1, 2.0)):
        status.add(frame=frame, stage="track", seconds=seconds, ok=True)
    status.add(frame=2, stage="track", seconds=9.0, ok=False, reason="no scan")
    assert evaluate(made[1])["all"]["seconds"] == {"track": 1.5}


def test_frames_that_the_capture_has_lost_are_named(made):
    shutil.rmtree(made[0] / "frames" / "000001")
    (made[0] / "frames" / "000004" / "scan.ply").write_text("ply\n")
    found = evaluate(made[1])
    (said,) = found["warnings"]
    assert said.startswith("frames 1, 4: they can no more be read of ")
    observed = [frame["evidence"]["observed"] for frame in found["per_frame"]]
    assert [value is None for value in observed] == [number in (1, 4) for number in range(6)]


def test_frames_whose_files_are_no_more_those_that_were_registered_are_named(made):
    capture, run = open_capture(made[0]), made[1]
    (run / "inputs").mkdir()
    for number in capture.frames:
        note_frame(run, capture, number)
    os.utime(made[0] / "frames" / "000003" / "scan.ply", (1, 1))  # written again, with the same bits
    assert not evaluate(run)["warnings"]
    shutil.copyfile(made[0] / "frames" / "000002" / "scan.ply", made[0] / "frames" / "000001" / "scan.ply")
    (made[0] / "frames" / "000004" / "keypoints.json").unlink()
    (said,) = evaluate(run)["warnings"]
    assert said.startswith("frames 1, 4: the capture's files are no more those that were registered")


@pytest.mark.parametrize("where", ("run", "aligned run"))
def test_cameras_and_labels_that_are_no_more_those_that_were_registered_are_named(made, tmp_path, where):
    root, run = made
    (run / "inputs").mkdir()
    (run / "inputs" / "scene.json").write_text(json.dumps({"facts": facts_of(open_capture(root))}))
    if where == "aligned run":
        aligned = shutil.copytree(run, tmp_path / "aligned", ignore=shutil.ignore_patterns("inputs"))
        with (aligned / "config.toml").open("a") as file:
            file.write(f"[align]\nrun = {json.dumps(str(run))}\n")
        run = aligned
    assert not evaluate(run)["warnings"]
    recalibrated(root, posed(lambda T: T + 0.01 * np.eye(4, k=3)), only="cam02")
    scene = root / "scene.toml"
    scene.write_text(scene.read_text().replace("hair = ", "locks = "))
    (said,) = evaluate(run)["warnings"]
    assert said.startswith(f"{root}: cameras.cam02, labels.hair, labels.locks: no more as {run} was registered with")


def test_a_garment_that_the_truth_lacks_is_named_and_not_measured(made):
    shutil.rmtree(made[0] / "truth" / "truth.zarr" / "garment")
    found = evaluate(made[1])
    assert len(found["warnings"]) == 1 and "garment tshirt: the truth has no such garment" in found["warnings"][0]
    shirt = found["all"]["garment"]["tshirt"]
    assert shirt["surface_mm"] is None and shirt["observed"] == 1 and found["all"]["label_iou"] is None
    assert found["all"]["inner"]["visible_mm"] < 1e-3


def test_a_template_that_the_truth_has_no_map_of_is_measured_by_surface_and_openings(made):
    with_another_template(*made)
    found = evaluate(made[1])
    assert "no map of this template" in found["warnings"][0]
    shirt = found["all"]["garment"]["tshirt"]
    assert shirt["correspondence_mm"] is None and shirt["jitter_mm"] is None
    assert shirt["surface_mm"] < 1e-3 and max(shirt["boundary_mm"].values()) < 1e-3 and len(shirt["boundary_mm"]) == 4
    assert shirt["surface_missed_mm"] < 1e-3 and max(shirt["boundary_missed_mm"].values()) < 1e-3
    assert "no map of this template" in write_report(made[1]).read_text()


def test_a_garment_that_lacks_a_part_is_right_one_way_and_misses_the_other():
    """A tube shorter than the true one lies on it wholly, and leaves its end and its border uncovered."""
    V, F = tube(rings=41, height=0.4)
    short = V[:, 2] <= 0.3 + 1e-9
    faces = F[short[F].all(1)]
    truth = SimpleNamespace(garment=lambda *_: (V, F))
    upper = np.flatnonzero(np.abs(V[short][:, 2] - 0.3) < 1e-9)
    told = Truth.garment_errors(truth, "tube", {"end": upper}, V[short], faces, 0, mapped=False)[0]
    assert told["surface_mm"] < 1e-6 and told["surface_missed_mm"] > 5
    assert told["boundary_mm"]["end"] == pytest.approx(100, rel=0.01)
    assert told["boundary_missed_mm"]["end"] == pytest.approx(100, rel=0.01)


def test_without_a_map_a_loop_is_measured_against_the_opening_of_its_name(made):
    """Sleeves that lie on one another's rims: the nearest rim would call them right."""
    store = with_another_template(*made)
    scene = store.attrs["scene"]
    loops = scene["garments"][0]["loops"]
    loops["sleeve_left"], loops["sleeve_right"] = loops["sleeve_right"], loops["sleeve_left"]
    store.attrs["scene"] = scene
    boundary = evaluate(made[1])["all"]["garment"]["tshirt"]["boundary_mm"]
    assert boundary["sleeve_left"] > 100 and boundary["sleeve_right"] > 100 and boundary["hem"] < 1e-3


def test_a_map_of_as_many_vertices_in_another_order_is_not_used(made):
    """The capture's template exchanged after the truth was made: the map would be silently wrong."""
    template = made[0] / "templates" / "tshirt.obj"
    mesh = read_mesh(template)
    order = np.random.default_rng(0).permutation(len(mesh.vertices)).astype(np.int32)
    V = np.empty_like(mesh.vertices)
    V[order] = mesh.vertices
    write_mesh(template, Mesh(V, order[mesh.faces], mesh.uv, mesh.face_uv))
    store = zarr.open_group(str(made[1] / "registered.zarr"), mode="r+")
    store["garment/tshirt/faces"][:] = order[mesh.faces]
    vertices = store["garment/tshirt/vertices"][:]
    store["garment/tshirt/vertices"][:] = vertices[:, np.argsort(order)]
    found = evaluate(made[1])
    assert "no map" in found["warnings"][0] and found["all"]["garment"]["tshirt"]["correspondence_mm"] is None


def test_cloth_moved_and_crumpled_is_told_by_where_nine_in_ten_lie_and_by_its_folds(made):
    store = zarr.open_group(str(made[1] / "registered.zarr"), mode="r+")
    V, F = store["garment/tshirt/vertices"], store["garment/tshirt/faces"][:]
    moved = V[:]
    moved[:, : V.shape[1] // 5] += [0, 0, 0.5]  # a fifth, half a metre off
    moved[:, F[0, 0]] = moved[:, F[len(F) // 2]].mean(1)  # one corner pulled into a face far away
    V[:] = moved
    shirt = evaluate(made[1])["all"]["garment"]["tshirt"]
    assert shirt["observed_p90_mm"] > 50 and shirt["folds"] > shirt["true_folds"]
