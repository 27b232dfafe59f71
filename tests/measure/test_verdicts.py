"""Evidence from both sides and the verdict that it gives, against exact cases and against full resolution."""

import dataclasses

import numpy as np
import pytest

from tests.support.rig import ring_of_cameras
from tests.support.shapes import sphere
from toile import kernels
from toile.config import VerdictSettings
from toile.io.files import load_record, save_record
from toile.io.layout import DOUBTFUL, GOOD, WRONG
from toile.io.run import open_run
from toile.measure.evaluate import evaluate
from toile.measure.evidence import parted
from toile.measure.glimpse import Glimpse, glimpse, outlines
from toile.measure.triage.advice import trouble_of
from toile.measure.verdicts import (
    JudgedLayer,
    _bare,
    _excess,
    _openings,
    agreement,
    beyond_people,
    severity,
    verdict,
)
from toile.scene import Frame, GarmentTemplate, Keypoints, Mesh
from toile.vision.visibility import DepthView

SETTINGS = VerdictSettings()
FINE = {"observed": 0.9, "scan_to_surface_mm": 1.0, "two_sided_mm": 1.0}


def ball():
    return sphere(radius=0.5)


def layer(V, F, label=None):
    return JudgedLayer("ball", label, V, F, np.full(len(V), 2, np.uint8), np.arange(len(V)))


def frame(V, F):
    return Frame(0, Mesh(V, F))


def test_two_spheres_about_one_point_lie_the_difference_of_their_radii_apart_from_either_side():
    V, F = ball()
    found = agreement(glimpse(frame(V, F)), {}, None, None, layer(1.02 * V, F))
    for name in ("scan_to_surface", "surface_to_scan"):
        assert found[f"{name}_mm"] == pytest.approx(10, abs=0.4)
        assert found[f"{name}_p50_mm"] == pytest.approx(10, abs=0.4)
        assert found[f"{name}_p95_mm"] == pytest.approx(10, abs=0.8)
    sides = {
        f"{side}_{part}mm" for side in ("scan_to_surface", "surface_to_scan") for part in ("", "p50_", "p80_", "p95_")
    }
    assert found["observed"] == 1 and set(found) == {"observed", "two_sided_mm", "apart", "scan_edge_mm", *sides}
    assert found["two_sided_mm"] == min(found["scan_to_surface_mm"], found["surface_to_scan_mm"])


def test_a_rigid_motion_of_everything_changes_no_distance():
    V, F = ball()
    turn, move = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0.0]]), np.array([3, -20, 5.0])
    one = agreement(glimpse(frame(V, F)), {}, None, None, layer(1.02 * V, F))
    two = agreement(glimpse(frame(V @ turn.T + move, F)), {}, None, None, layer(1.02 * V @ turn.T + move, F))
    assert one == pytest.approx(two, abs=1e-6)


def test_what_the_surface_lacks_shows_from_the_scan_and_what_the_scan_lacks_from_the_surface():
    V, F = ball()
    half = F[(V[F][:, :, 2] > 0).all(1)]
    scan_only = agreement(glimpse(frame(V, F)), {}, None, None, layer(V, half))
    assert scan_only["scan_to_surface_p95_mm"] > 300 and scan_only["observed"] == 1 and scan_only["apart"] == 0
    surface_only = agreement(glimpse(frame(V, half)), {}, None, None, layer(V, F))
    assert surface_only["surface_to_scan_p95_mm"] > 300 and surface_only["scan_to_surface_p95_mm"] < 1
    assert surface_only["apart"] == 0


def test_a_limb_that_is_bent_elsewhere_is_told_by_the_share_of_it_on_either_side():
    """Two balls, one with its right cap drawn out, the other its top; against every vertex of both."""
    V, F = ball()
    scan, bent = V.copy(), V.copy()
    scan[V[:, 0] > 0.45, 0] += 0.4
    bent[V[:, 2] > 0.4, 2] += 0.4
    found = agreement(glimpse(frame(scan, F)), {}, None, None, layer(bent, F))
    of_surface = kernels.SurfaceIndex(scan, F).closest(bent)[3] > 0.02
    assert 0.2 < of_surface.mean() < 0.25  # the scan's share, whose faces are drawn out, is larger
    assert found["apart"] == pytest.approx(of_surface.mean(), abs=0.02)
    assert verdict(FINE | {"apart": found["apart"]}, SETTINGS)[0] != GOOD


def test_the_thinned_evidence_is_that_of_the_whole_scan(sample_run):
    """An independent oracle: evaluate measures every vertex of the scan against every vertex of the surface."""
    run = open_run(sample_run)
    for whole in evaluate(run)["per_frame"]:
        thin = run.diagnostics.at(whole["frame"])["evidence"]
        assert thin["observed"] == pytest.approx(whole["evidence"]["observed"])
        assert thin["scan_to_surface_mm"] == pytest.approx(whole["evidence"]["scan_to_surface_mm"]["mean"], abs=0.7)
        assert thin["surface_to_scan_mm"] == pytest.approx(whole["evidence"]["surface_to_scan_mm"]["mean"], abs=2.5)
        assert thin["keypoint_px"] == pytest.approx(whole["evidence"]["keypoint_px"]["median"], rel=0.05)
        assert thin["silhouette_iou"] == pytest.approx(whole["evidence"]["silhouette_iou"], abs=0.04)


def test_a_glimpse_comes_back_from_its_file(tmp_path):
    V, F = ball()
    keypoints = Keypoints(("body.nose",), {"a": np.array([[3.0, 4.0, 0.5]])})
    made = glimpse(Frame(0, Mesh(V, F), keypoints, masks={"a": np.eye(200, dtype=bool)}), np.ones(len(F)))
    save_record(tmp_path / "seen.npz", made)
    back = load_record(tmp_path / "seen.npz", Glimpse)
    for name in (field.name for field in dataclasses.fields(Glimpse)):
        assert np.array_equal(getattr(made, name), getattr(back, name)), name


def test_evidence_without_fault_is_good_and_the_worst_measure_decides():
    assert verdict(FINE, SETTINGS) == (GOOD, [])
    between = np.mean(SETTINGS.two_sided_mm)
    level, reasons = verdict(FINE | {"two_sided_mm": between}, SETTINGS)
    assert level == DOUBTFUL and len(reasons) == 1 and f"{between:.0f} mm apart" in reasons[0]
    level, reasons = verdict(FINE | {"two_sided_mm": between, "silhouette_iou": 0.1}, SETTINGS)
    assert level == WRONG and len(reasons) == 2 and "silhouette" in reasons[0]


@pytest.mark.parametrize("name", list(VerdictSettings.model_fields))
def test_a_frame_gets_no_better_as_a_measure_gets_worse(name):
    doubtful, wrong = getattr(SETTINGS, name)
    steps = np.linspace(2 * doubtful - wrong, 2 * wrong - doubtful, 40)
    levels = [verdict(FINE | {name: value}, SETTINGS)[0] for value in steps]
    assert levels == sorted(levels) and levels[0] == GOOD and levels[-1] == WRONG
    if name != "observed":
        assert levels == [verdict(FINE | {f"shirt.{name}": value}, SETTINGS)[0] for value in steps]


@pytest.mark.parametrize("name", VerdictSettings.model_fields)
def test_one_limit_for_both_verdicts_is_met_from_the_same_side(name):
    doubtful, wrong = getattr(SETTINGS, name)
    limit, step = (doubtful + wrong) / 2, (wrong - doubtful) / 4
    settings = SETTINGS.model_copy(update={name: (limit, limit)})
    levels = [verdict(FINE | {name: limit + way * step}, settings)[0] for way in (-1, 1)]
    assert levels == [GOOD, WRONG]
    assert severity({name: limit - step}, settings) < 1 < severity({name: limit + step}, settings)


def test_frames_are_the_worse_the_farther_they_are_beyond_a_limit_and_wrong_ones_worse_than_doubtful_ones():
    """Down to nothing at all, as of a limb that neither scan nor pictures show."""
    steps = np.linspace(0, 1, 9)[1:]
    for name, (doubtful, wrong) in ((name, getattr(SETTINGS, name)) for name in VerdictSettings.model_fields):
        at = [severity({name: doubtful + share * (wrong - doubtful)}, SETTINGS) for share in steps]
        assert at == sorted(set(at)) and 1 < at[0] and at[-1] == pytest.approx(2)
    assert severity(FINE | {"pairs_left": 0.0}, SETTINGS) < 1


def test_a_scan_of_holes_and_clutter_is_answered_by_keypoints_and_silhouettes_together():
    scan = FINE | {"two_sided_mm": 100.0, "apart": 0.3, "astray": 0.3}
    both = {"keypoint_mm": 10.0, "silhouette_iou": 0.97}
    assert verdict(scan | both, SETTINGS)[0] == GOOD
    for missing in both:
        assert verdict(scan | {name: value for name, value in both.items() if name != missing}, SETTINGS)[0] == WRONG
    assert verdict(scan | both | {"silhouette_iou": 0.9}, SETTINGS)[0] == WRONG


def test_a_person_of_no_person_s_stature_is_doubtful():
    tall = lambda metres: verdict(FINE | {"stature_off_m": beyond_people(metres * np.eye(3))}, SETTINGS)
    assert tall(1.0) == tall(1.65) == tall(2.3) == (GOOD, [])
    for metres, level in ((0.95, DOUBTFUL), (2.4, DOUBTFUL), (0.4, WRONG), (16.0, WRONG)):
        judged, reasons = tall(metres)
        assert judged == level and "stature" in reasons[0] and trouble_of(reasons[0])


def test_little_of_a_body_that_only_the_scan_shows_is_doubtful():
    assert verdict(FINE | {"observed": 0.2}, SETTINGS)[0] == DOUBTFUL
    assert verdict(FINE | {"observed": 0.2, "keypoint_mm": 10.0}, SETTINGS)[0] == GOOD


def test_a_camera_that_looks_elsewhere_with_an_empty_mask_changes_no_silhouette():
    (V, F), here = ball(), ring_of_cameras(1)["cam0"]
    V = V + [0, 0, 1]
    away = dataclasses.replace(here, T_camera_world=np.diag([-1.0, 1, -1, 1]) @ here.T_camera_world)
    mask = DepthView(here, V, F).face >= 0
    assert mask.any() and not (DepthView(away, V, F).face >= 0).any()
    cameras = {"here": here, "away": away}
    for masks in ({"here": mask}, {"here": mask, "away": np.zeros_like(mask)}):
        found = agreement(glimpse(Frame(0, Mesh(V, F), masks=masks)), cameras, None, None, layer(V, F))
        assert found["silhouette_iou"] > 0.98
    nobody = Frame(0, Mesh(V, F), masks={"away": np.zeros_like(mask)})
    assert "silhouette_iou" not in agreement(glimpse(nobody), cameras, None, None, layer(V, F))


def masked_balls(empty, shown_by, aside=0.0, cameras=5):
    """What `agreement` says of a ball that lies `aside` of where masks and scan show it, with the masks of `empty` cameras empty."""
    (V, F), cameras = ball(), ring_of_cameras(cameras)
    masks = {name: DepthView(camera, V, F).face >= 0 for name, camera in cameras.items()}
    masks |= {name: np.zeros_like(masks[name]) for name in empty}
    at = {name: np.column_stack([camera.project(V[::9])[0], np.ones(len(V[::9]))]) for name, camera in cameras.items()}
    keypoints = Keypoints(tuple(f"body.{i}" for i in range(len(V[::9]))), at) if shown_by == "keypoints" else None
    shown = Frame(0, Mesh(V, F) if shown_by == "scan" else None, keypoints, masks=masks)
    model = type("Model", (), {"keypoint_names": (), "keypoints": lambda *_: np.zeros((0, 3))})
    return agreement(glimpse(shown), cameras, model, None, layer(V + [aside, 0, 0], F))


@pytest.mark.parametrize("shown_by", ["scan", "keypoints", "masks"])
def test_an_empty_mask_where_scan_keypoints_or_the_other_masks_show_the_person_is_left_out_and_said(shown_by):
    whole = masked_balls((), shown_by)
    assert whole["silhouette_iou"] > 0.98 and "masks_empty" not in whole
    found = masked_balls(("cam1", "cam3"), shown_by)
    assert found["silhouette_iou"] > 0.98 and found["masks_empty"] == 2


def test_an_empty_mask_tells_where_nothing_else_shows_the_person_or_most_masks_are_empty():
    found = masked_balls(("cam1",), "masks", aside=1.0)  # where no other mask shows anybody
    assert found["silhouette_iou"] < 0.2 and "masks_empty" not in found
    assert masked_balls(("cam0", "cam1", "cam2"), "scan")["silhouette_iou"] < 0.5


def test_an_empty_mask_tells_where_two_others_alone_show_the_person():
    found = masked_balls(("cam1",), "masks", cameras=3)
    assert found["silhouette_iou"] < 0.7 and "masks_empty" not in found


@pytest.mark.parametrize("shown_by", ["scan", "masks"])
def test_a_body_that_lies_aside_is_told_as_well_beside_an_empty_mask(shown_by):
    aside = [masked_balls(empty, shown_by, aside=0.3)["silhouette_iou"] for empty in ((), ("cam0",))]
    assert verdict(FINE | {"silhouette_iou": max(aside)}, SETTINGS)[0] == WRONG


def test_a_garment_that_was_hardly_found_is_no_good_whatever_shows_the_body():
    shown = FINE | {"keypoint_mm": 10.0, "silhouette_iou": 0.97}
    assert verdict(shown | {"shirt.garment_observed": 0.6}, SETTINGS)[0] == GOOD
    assert verdict(shown | {"shirt.garment_observed": 0.2}, SETTINGS)[0] == DOUBTFUL
    assert verdict(shown | {"shirt.garment_observed": 0.0}, SETTINGS)[0] == WRONG


def test_one_pair_of_triangles_that_go_through_one_another_is_doubtful():
    assert verdict(FINE | {"pairs_left": 0.0}, SETTINGS)[0] == GOOD
    level, reasons = verdict(FINE | {"pairs_left": 1.0}, SETTINGS)
    assert level == DOUBTFUL and "1 pairs of triangles" in reasons[0]


def test_facial_keypoints_half_of_which_lie_off_the_face_are_doubtful_and_never_wrong_alone():
    assert verdict(FINE | {"face_off": 0.5}, SETTINGS) == (GOOD, [])
    level, (reason,) = verdict(FINE | {"face_off": 1.0}, SETTINGS)
    assert level == DOUBTFUL and reason.startswith("1 of the facial keypoints lie off the face")


def test_a_frame_without_a_scan_is_doubtful_at_best():
    level, reasons = verdict({"observed": 0.0, "keypoint_mm": 5.0}, SETTINGS)
    assert level >= DOUBTFUL and any("no scan" in reason for reason in reasons)


def test_every_registered_frame_has_a_verdict_and_its_measures(sample_run):
    run = open_run(sample_run)
    assert run.verdict.dtype == np.uint8 and run.verdict.shape == run.done.shape
    for number in run.ok:
        found = run.diagnostics.at(number)
        assert found["verdict"] == run.verdict[run.row(number)] == verdict(found["evidence"], SETTINGS)[0]
        assert found["evidence"]["tshirt.garment_observed"] > 0.5 and found["evidence"]["face_off"] < 0.3
    counts = evaluate(run)["all"]["verdicts"]
    assert sum(counts.values()) == 4 and counts["wrong"] == 0


def test_a_scan_of_few_triangles_is_said():
    """An octahedron of radius 0.1 m: all its edges are sqrt(2) 0.1 m long."""
    V = 0.1 * np.concatenate([np.eye(3), -np.eye(3)])
    F = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]], np.int32)
    found = agreement(glimpse(frame(V, F)), {}, None, None, layer(V, F))
    assert found["scan_edge_mm"] == pytest.approx(141.42, abs=0.01)
    level, reasons = verdict(found, SETTINGS)
    assert level == DOUBTFUL and "the scan's triangles are 141 mm wide" in reasons[0]
    V, F = ball()
    assert verdict(agreement(glimpse(frame(V, F)), {}, None, None, layer(V, F)), SETTINGS) == (GOOD, [])


def test_a_silhouette_is_that_of_body_and_garments_together():
    """A body that lacks what a garment covers, as the skirt between two legs."""
    V, F = ball()
    cameras = ring_of_cameras(3)
    masks = {name: DepthView(camera, V, F).face >= 0 for name, camera in cameras.items()}
    seen = glimpse(Frame(0, Mesh(V, F), masks=masks))
    low = (V[F][:, :, 2] < 0.1).all(1)
    legs, skirt = layer(V, F[~low]), dataclasses.replace(layer(V, F[low]), name="skirt")
    shown = lambda *garments: agreement(seen, cameras, None, None, legs, garments)["silhouette_iou"]
    assert shown() < 0.9 and shown(skirt) > 0.95


def test_masks_part_as_far_as_a_patch_of_one_reaches_beyond_the_other():
    """A tongue of 4 by 10 pixels of 5 mm: its last n rows of 4 pixels, of 1 cm^2 each, are 11 - n pixels away and more."""
    block, tongue = np.zeros((2, 40, 60), bool)
    block[10:30, 10:30] = tongue[10:30, 10:30] = True
    tongue[18:22, 30:40] = True
    for n in (1, 4, 8):
        assert parted(tongue, block, 0.005, n * 1e-4) == pytest.approx(0.005 * (11 - n))
    assert parted(block, tongue, 0.005, 1e-4) == 0
    grown = np.zeros_like(block)
    grown[9:31, 9:31] = True
    assert parted(grown, block, 0.005, 1e-4) == 0  # by one pixel all around
    assert parted(tongue, block, 0.005, 1) == 0  # less than the area
    assert parted(block, np.zeros_like(block), 0.005, 1e-4) == 0


def outlined(clothed=True, **radii):
    """(measures, verdict) of a ball of radius 0.5 m, whose upper half is cloth, judged by four cameras; `radii` {camera: of
    the ball that its mask shows [m]}. Not `clothed`: it is one surface."""
    V, F = ball()
    cameras = ring_of_cameras(4)
    masks = {name: DepthView(camera, 2 * radii.get(name, 0.5) * V, F).face >= 0 for name, camera in cameras.items()}
    upper = (V[F][:, :, 2] > 0).all(1)
    body, cap = layer(V, F[~upper] if clothed else F), dataclasses.replace(layer(V, F[upper]), name="cap")
    seen = glimpse(Frame(0, Mesh(V, F), masks=masks))
    found = agreement(seen, cameras, None, None, body, (cap,) if clothed else ())
    return found, verdict(
        {k: v for k, v in found.items() if k.endswith(("uncovered_mm", "overhang_mm"))} | LOOKED, SETTINGS
    )


LOOKED = {"scan_to_surface_mm": 1.0}


@pytest.mark.parametrize("part", (1.0, 0.4))
def test_without_masks_label_images_tell_a_surface_that_lies_beside_them_though_they_show_a_part_of_it(part):
    """A ball of radius 0.5 m beside its labels, which show it from below up to a share of its height."""
    V, F = ball()
    cameras = ring_of_cameras(4)
    low = F[(V[F][:, :, 2] < part - 0.5).all(1)]
    labels = {name: 3 * (DepthView(camera, V, low).face >= 0).astype(np.uint8) for name, camera in cameras.items()}
    judged = lambda seen, x: verdict(agreement(seen, cameras, None, None, layer(V + [x, 0, 0], F)), SETTINGS)
    scanned = lambda x, **pictures: glimpse(Frame(0, Mesh(V + [x, 0, 0], F), **pictures))
    assert judged(scanned(0, labels=labels), 0) == (GOOD, [])
    level, reasons = judged(scanned(0.2, labels=labels), 0.2)
    assert level != GOOD and "label images" in reasons[0] and trouble_of(reasons[0])
    assert judged(scanned(0.2, labels=labels, certainty=labels), 0.2) == (GOOD, [])  # a network's guess is no evidence
    thin = glimpse(Frame(0, Mesh(V, F)), None, outlines(Frame(0, None, labels=labels)))
    assert agreement(thin, cameras, None, None, layer(V, F))["labels_off"] < 0.02


def test_cloth_in_the_air_and_what_nothing_covers_are_said_where_two_cameras_show_it():
    a, b, *_ = ring_of_cameras(4)
    for radii in ({}, {a: 0.45}, {a: 0.55}):
        found, judged = outlined(**radii)
        assert judged == (GOOD, []) and found["uncovered_mm"] == found["cap.cloth_overhang_mm"] == 0
    found, (level, reasons) = outlined(**{a: 0.45, b: 0.45})
    assert found["overhang_mm"] == pytest.approx(50, abs=8) and found["cap.cloth_overhang_mm"] > 40
    assert (
        found["uncovered_mm"] == 0 and level == DOUBTFUL and any("cap: cloth reaches" in reason for reason in reasons)
    )
    found, (level, reasons) = outlined(**{a: 0.55, b: 0.55})
    assert found["uncovered_mm"] == pytest.approx(50, abs=8) and found["overhang_mm"] == 0
    assert level == DOUBTFUL and "beyond the silhouette" in reasons[0]


def test_free_ends_of_cloth_are_no_fault_of_a_surface_that_is_tracked_alone():
    a, b, *_ = ring_of_cameras(4)
    found, judged = outlined(False, **{a: 0.55, b: 0.55})
    assert "uncovered_mm" not in found and judged == (GOOD, [])
    assert outlined(False, **{a: 0.45, b: 0.45})[1][0] == DOUBTFUL


def test_an_opening_longer_or_shorter_than_the_cloth_about_it_leads_to_expect_is_said():
    """A web of the scan may cut a sleeve's opening off, or join it to the trunk, in every frame of a run alike. A narrow cuff
    may be wider than the template's; a long hem is longer by as much at once."""

    def judged(length, share):
        angle = np.arange(64) * 2 * np.pi / 64
        ring = length / (2 * np.pi) * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
        shirt = GarmentTemplate("shirt", 1, *(None,) * 5, loops=(np.arange(64),), loop_names=("end",))
        said = {"loop_observed.end": 1.0, "loop_mm.end": 1.0, "loop_share.end": share}
        return verdict(_openings(shirt, said) | _excess(shirt, ring, said) | LOOKED, SETTINGS)

    for sound in ((0.4, 0.93), (0.4, 1.0), (0.18, 1.41), (0.4, 1.25), (1.1, 1.15)):
        assert judged(*sound) == (GOOD, [])
    for length, share, words in (
        (0.4, 0.9, "it is cut off (at least 0.92"),
        (0.46, 1.41, "134 mm longer than the cloth about it leads to expect: it is joined to other cloth (at most 100"),
    ):
        level, (reason,) = judged(length, share)
        assert level == DOUBTFUL and reason.startswith("shirt.end: ") and words in reason
        assert trouble_of(reason).title in ("an opening is cut off", "an opening is joined to other cloth")
    assert judged(0.4, 0.4)[0] == judged(1.0, 2.6)[0] == WRONG


def test_a_sleeve_whose_opening_runs_over_the_trunk_is_said():
    for share, level in ((0.0, GOOD), (0.1, GOOD), (0.15, DOUBTFUL), (0.7, WRONG)):
        judged = verdict({"shirt.sleeve_left.loop_at_trunk": share} | LOOKED, SETTINGS)
        assert judged[0] == level
        if level != GOOD:
            assert judged[1][0].startswith("shirt.sleeve_left: ") and "lies at the trunk" in judged[1][0]
            assert trouble_of(judged[1][0]).title == "a sleeve is joined to the trunk"


def test_openings_that_a_frame_does_not_show_count_where_other_frames_show_them():
    """A hem that is tucked in throughout has no length, and is no fault; a neck that other frames show has one."""
    names = ("neck", "hem")
    shirt = GarmentTemplate("shirt", 1, *(None,) * 5, loops=(None, None), loop_names=names)
    said = {f"loop_observed.{name}": share for name, share in zip(names, (0.2, 0.1))}
    said |= {f"loop_mm.{name}": 1.0 for name in names}
    judged = lambda **known: verdict(_openings(shirt, said | known) | LOOKED, SETTINGS)
    assert judged() == (GOOD, [])
    said["loop_observed.neck"] = 0.6
    level, reasons = judged(**{"loop_length.neck": 1.0})
    assert level == DOUBTFUL and "0.6 of the openings" in reasons[0]
    said["loop_observed.neck"] = 0.9
    assert judged(**{"loop_length.neck": 1.0}) == (GOOD, [])
    assert judged(**{"loop_length.neck": 1.0, "loop_length.hem": 1.0})[0] == DOUBTFUL


def test_an_opening_of_which_every_frame_shows_half_is_not_tucked_in():
    """As where all cameras stand on one side: no frame shows any opening whole, and each a part of all."""
    names = ("neck", "hem")
    shirt = GarmentTemplate("shirt", 1, *(None,) * 5, loops=(None, None), loop_names=names)
    half = {f"loop_observed.{name}": 0.5 for name in names} | {f"loop_mm.{name}": 1.0 for name in names}
    level, (reason,) = verdict(_openings(shirt, half) | LOOKED, SETTINGS)
    assert level == DOUBTFUL and "0.5 of the openings" in reason and trouble_of(reason).title == "openings are not seen"


def test_an_opening_that_nothing_shows_is_guessed_where_there_is_no_scan_and_tucked_in_where_there_is():
    V, F = ball()
    equator = np.flatnonzero(np.abs(V[:, 2]) < 0.03)
    shirt = GarmentTemplate("shirt", 1, None, F, *(None,) * 3, loops=(equator,), loop_names=("hem",))
    unseen, part = {"loop_observed.hem": 0.0}, {"loop_observed.hem": 0.5}
    whole, top = frame(V, F), frame(V, F[(V[F][:, :, 2] > 0.2).all(1)])
    assert _bare(glimpse(whole), shirt, V, unseen) == {"shirt.opening_bare": 0}
    assert _bare(glimpse(top), shirt, V, part) == _bare(glimpse(top), shirt, V, unseen | {"loop_length.hem": 1}) == {}
    bare = _bare(glimpse(top), shirt, V, unseen)
    assert bare == {"shirt.opening_bare": 1}
    level, (reason,) = verdict(LOOKED | bare, SETTINGS)
    assert level == DOUBTFUL and trouble_of(reason).title == "an opening is guessed"
