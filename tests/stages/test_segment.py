"""Labels and borders on a painted ball seen by synthetic cameras."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.rig import ring_of_cameras
from tests.support.shapes import sphere
from toile.config import SegmentSettings
from toile.errors import UserError
from toile.scene import Camera, Frame, Garment, Mesh, Scene, Tracked, Vote
from toile.stages.segment import coarse_pictures, evidence, prepare, segment, unlabelled_pictures
from toile.surface.curves import isolines
from toile.vision.completion import complete_labels
from toile.vision.evidence import Crop, depth_views, soft_crop, soft_labels
from toile.vision.visibility import DepthView

CENTRE, OPENING, RADIUS = np.array([0, 0, 1.0]), 1.05, 0.5


def true_label(points):
    """Shirt (2) above the opening, skin (1) below."""
    return np.where(points[..., 2] > OPENING, 2, 1)


@pytest.fixture(scope="module")
def ball():
    V, F = sphere(90, 180, RADIUS)
    V = V + CENTRE
    cameras, rng = ring_of_cameras(6, distortion=(-0.03, 0, 0, 0, 0)), np.random.default_rng(0)
    images, labels = {}, {}
    for name, camera in cameras.items():
        view = DepthView(camera, V, F)
        seen = view.face >= 0
        centroid = V[F].mean(1)
        picture, uv = np.full((512, 512, 3), 70.0), np.argwhere(seen)[:, ::-1]
        picture[seen] = 0
        # the opening as the camera sees it: four by four rays a pixel on the exact sphere
        offsets = (np.arange(4) + 0.5) / 4
        for dy in offsets:
            for dx in offsets:
                label = true_label(on_ball(camera, uv + [dx, dy]))
                picture[seen] += np.where((label == 2)[:, None], [60, 90, 170], [215, 165, 140]) / 16
        images[name] = np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)
        given = np.where(seen, true_label(centroid[view.face.clip(0)]), 0).astype(np.uint8)
        given = np.where(seen & (np.roll(given, -4, 0) > 0), np.roll(given, -4, 0), given)  # border four pixels too low
        for _ in range(6):  # blobs
            at = np.argwhere(seen)[rng.integers(seen.sum())]
            blob = seen & (np.hypot(*(np.indices(seen.shape) - at[:, None, None])) < 8)
            given[blob] = rng.integers(1, 3)
        labels[name] = given
    scene = Scene("ball", 30, "m", "z", "anny", {"skin": 1, "shirt": 2}, (Garment("shirt", "t.obj", "shirt"),))
    coarse_V, coarse_F = sphere(50, 80, RADIUS)
    n = len(coarse_V)
    tracked = Tracked(coarse_V + CENTRE, np.zeros((1, 3)), np.zeros(3), np.zeros((0, 3)), np.full(n, 2, np.uint8), {})
    return scene, cameras, Frame(0, Mesh(V, F), None, images, {}, labels), tracked, coarse_F


def on_ball(camera, uv):
    """Points of the ball under pixels (undistorted by fixed-point steps); anywhere where the ray misses."""
    target = (uv - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]]
    xy = target.copy()
    for _ in range(8):
        xy += target - camera.distort(xy)
    d = np.concatenate([xy, np.ones((len(xy), 1))], 1) @ camera.T_camera_world[:3, :3]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = camera.centre - CENTRE
    b = d @ o
    return camera.centre + (-b - np.sqrt(np.maximum(b * b - o @ o + RADIUS**2, 0)))[:, None] * d


def test_blurred_labels_about_the_surface_are_those_of_the_whole_picture(ball):
    _, cameras, frame, _, _ = ball
    settings, ids = SegmentSettings(), np.array([1, 2], np.uint8)
    name, camera = next(iter(cameras.items()))
    view = DepthView(camera, frame.scan.vertices, frame.scan.faces)
    uv, weight, _ = view.visibility(frame.scan.vertices, frame.scan.normals, 0.01, 0.1)
    crop, whole = (
        soft_crop(view, frame.labels[name], ids, settings),
        Crop(soft_labels(frame.labels[name], ids, settings)),
    )
    assert crop.values.size < 0.9 * whole.values.size and (weight > 0).sum() > 1000
    np.testing.assert_array_equal(crop.read(uv[weight > 0]), whole.read(uv[weight > 0]))


def labelled(scene, cameras, model, frame, tracked, faces):
    settings = SegmentSettings(refine_border=True)
    seen = evidence(frame, cameras, model, tracked, faces, settings)
    return segment(scene, seen, model, tracked, faces, settings)


def test_border_is_found_within_two_millimetres_under_shifted_labels_and_blobs(ball):
    scene, cameras, frame, tracked, faces = ball
    model = prepare(scene, cameras, [(frame, tracked)], faces, SegmentSettings())
    result = labelled(scene, cameras, model, frame, tracked, faces)
    wrong = result.vertices != true_label(tracked.vertices)
    assert wrong.mean() < 0.02
    V, F = frame.scan.vertices, frame.scan.faces
    opening = isolines(V, F, result.scan_probability[:, 1].astype(float))[0]
    assert opening.closed and np.abs(opening.points[:, 2] - OPENING).mean() < 0.002
    assert np.abs(result.openings[2][0].points[:, 2] - OPENING).mean() < 0.002
    np.testing.assert_allclose(result.scan_probability.sum(1), 1, atol=1e-4)


def test_segment_gives_the_same_bits_for_any_number_of_threads(ball, threads):
    scene, cameras, frame, tracked, faces = ball
    results = []
    for count in (1, 3):
        threads(count)
        model = prepare(scene, cameras, [(frame, tracked)], faces, SegmentSettings())
        results.append(labelled(scene, cameras, model, frame, tracked, faces))
    assert np.array_equal(results[0].scan_probability, results[1].scan_probability)
    assert np.array_equal(results[0].vertices, results[1].vertices)


def test_labels_of_pictures_that_show_nothing_of_the_surface_give_no_colours(ball):
    scene, cameras, frame, tracked, faces = ball
    away = replace(tracked, vertices=tracked.vertices + [0, 0, 1000.0])
    assert prepare(scene, cameras, [(frame, away)], faces, SegmentSettings()).colours is None


def test_label_that_no_picture_carries_is_refused_by_name(ball):
    scene, cameras, frame, tracked, faces = ball
    wrong = Scene("ball", 30, "m", "z", "anny", {"skin": 1, "shirt": 2, "coat": 7}, (Garment("coat", "t.obj", "coat"),))
    with pytest.raises(UserError, match="labels.coat = 7"):
        prepare(wrong, cameras, [(frame, tracked)], faces, SegmentSettings())


def with_scan_labels(frame, images=False):
    """The ball's scan with labels of its own, wrong in blobs and missing in one; pictures and label images on demand."""
    V, F = frame.scan.vertices, frame.scan.faces
    centre, rng = V[F].mean(1), np.random.default_rng(1)
    labels = true_label(centre).astype(np.uint8)
    for wrong in (1, 2, 1, 2, 1, 2, 0):
        labels[np.linalg.norm(centre - centre[rng.integers(len(F))], axis=1) < 0.04] = wrong
    scan = Mesh(V, F, face_labels=labels)
    return Frame(0, scan, None, frame.images, {}, frame.labels) if images else Frame(0, scan)


def test_labels_of_the_scan_alone_do_without_cameras_and_colours(ball):
    scene, _, frame, tracked, faces = ball
    frame = with_scan_labels(frame)
    model = prepare(scene, {}, [(frame, tracked)], faces, SegmentSettings())
    assert model.colours is None
    result = labelled(scene, {}, model, frame, tracked, faces)
    assert (result.vertices != true_label(tracked.vertices)).mean() < 0.02 and result.diagnostics["seen"] > 0.98
    opening = isolines(frame.scan.vertices, frame.scan.faces, result.scan_probability[:, 1].astype(float))[0]
    assert opening.closed and np.abs(opening.points[:, 2] - OPENING).mean() < 0.004  # faces are 17 mm long
    assert len(result.openings[2]) == 1 and np.abs(result.openings[2][0].points[:, 2] - OPENING).mean() < 0.004


def test_labels_of_scan_and_pictures_together_leave_less_wrong_than_either(ball):
    scene, cameras, frame, tracked, faces = ball
    wrong = []
    for one, views in ((frame, cameras), (with_scan_labels(frame), {}), (with_scan_labels(frame, True), cameras)):
        seen = evidence(
            one,
            views,
            prepare(scene, views, [(one, tracked)], faces, SegmentSettings()),
            tracked,
            faces,
            SegmentSettings(),
        )
        wrong.append((seen.scan_costs()[0].argmin(1) != np.where(true_label(one.scan.vertices) == 2, 1, 0)).mean())
    assert wrong[2] < min(wrong[:2])


def test_a_frame_without_labels_takes_those_of_its_places(ball):
    scene, cameras, frame, tracked, faces = ball
    model = prepare(scene, {}, [(with_scan_labels(frame), tracked)], faces, SegmentSettings())
    result = labelled(scene, cameras, model, Frame(1, frame.scan), tracked, faces)
    assert (result.vertices != true_label(tracked.vertices)).mean() < 0.03 and result.diagnostics["seen"] == 0


def test_a_scene_without_any_labels_is_refused(ball):
    scene, cameras, frame, tracked, faces = ball
    with pytest.raises(UserError, match="label images or labels on its scan"):
        prepare(scene, cameras, [(Frame(0, frame.scan), tracked)], faces, SegmentSettings())


def test_pictures_whose_pixels_are_wide_at_the_person_are_warned_of():
    model, labels = np.zeros((5, 3)), {"a": np.zeros((64, 64), np.uint8)}
    far = np.eye(4) + 3.0 * np.outer([0, 0, 1, 0], [0, 0, 0, 1])
    tracked = Tracked(model, *(None,) * 5)
    frame = Frame(0, None, labels=labels)
    for focal, warned in ((90.0, "a pixel is 33 mm wide"), (500.0, None)):
        camera = Camera("a", 64, 64, np.diag([focal, focal, 1.0]), np.zeros(5), far)
        found = coarse_pictures({"a": camera}, [(frame, tracked)], SegmentSettings())
        assert (warned in found[0]) if warned else found == []
    assert coarse_pictures({}, [(Frame(0, None), tracked)], SegmentSettings()) == []


def without_labels(frame, names):
    return replace(frame, labels={name: image for name, image in frame.labels.items() if name not in names})


def test_one_labelled_picture_and_unlabelled_others_place_the_border(ball):
    """What the one picture shows gives the colours; the other pictures are labelled by them, and by each place."""
    scene, cameras, frame, tracked, faces = ball
    key = without_labels(frame, [name for name in cameras if name != "cam0"])
    model = prepare(scene, cameras, [(key, tracked)], faces, SegmentSettings())
    assert (model.ids[model.prior.argmax(1)] != true_label(tracked.vertices)).mean() < 0.03
    for shown in (key, without_labels(frame, list(cameras))):
        result = labelled(scene, cameras, model, shown, tracked, faces)
        assert (result.vertices != true_label(tracked.vertices)).mean() < 0.02
        border = isolines(frame.scan.vertices, frame.scan.faces, result.scan_probability[:, 1].astype(float))[0]
        assert border.closed and np.abs(border.points[:, 2] - OPENING).mean() < 0.002


def test_of_few_views_those_with_a_label_image_come_first_and_only_what_is_read_is_completed(ball, monkeypatch):
    scene, cameras, frame, tracked, faces = ball
    model = prepare(scene, cameras, [(frame, tracked)], faces, SegmentSettings())
    key = without_labels(frame, [name for name in cameras if name not in ("cam4", "cam5")])
    told = []
    watched = lambda frame, views, *rest: told.append(set(views)) or complete_labels(frame, views, *rest)
    monkeypatch.setattr("toile.stages.segment.complete_labels", watched)
    read = set(evidence(key, cameras, model, tracked, faces, SegmentSettings(views=3)).views)
    assert len(read) == 3 and told == [read - {"cam4", "cam5"}]


def test_pictures_without_a_label_image_are_counted_and_said(ball):
    _, cameras, frame, tracked, _ = ball
    key = without_labels(frame, [name for name in cameras if name != "cam0"])
    assert unlabelled_pictures([(frame, tracked)]) == []
    (said,) = unlabelled_pictures([(frame, tracked), (key, tracked)])
    assert said.startswith("labels: 5 of 12 sampled pictures")


def test_where_every_picture_is_labelled_none_is_completed(ball):
    scene, cameras, frame, tracked, faces = ball
    with_rounds = prepare(scene, cameras, [(frame, tracked)], faces, SegmentSettings())
    without = prepare(scene, cameras, [(frame, tracked)], faces, SegmentSettings(completion_rounds=0))
    assert np.array_equal(with_rounds.prior, without.prior)


def test_a_completed_picture_ends_at_the_surface_and_at_the_mask_and_leaves_out_what_is_unsure(ball):
    scene, cameras, frame, tracked, faces = ball
    model = prepare(scene, cameras, [(frame, tracked)], faces, SegmentSettings())
    views = depth_views(cameras, cameras, tracked.vertices, faces)
    left = np.zeros((512, 512), bool)
    left[:, :256] = True
    bare = replace(frame, labels={}, masks={"cam1": left})
    half = SegmentSettings(sure_share=0.9999)
    told = complete_labels(bare, views, model.prior, faces, model.colours, model.ids, SegmentSettings())
    unsure = complete_labels(bare, views, model.prior, faces, model.colours, model.ids, half)
    assert set(told) == set(cameras) and not told["cam1"][:, 256:].any()
    for name, view in views.items():
        shown = (view.face >= 0) & (left if name == "cam1" else True)
        assert np.array_equal(told[name] > 0, shown)
        assert np.isin(told[name], [0, 1, 2, 255]).all() and (told[name] == 255).sum() < (unsure[name] == 255).sum()
        right = told[name] == frame.labels[name]
        assert (
            right[(told[name] > 0) & (told[name] < 255)].mean() > 0.95
        )  # those given are four pixels off and wrong in blobs


@pytest.mark.parametrize("prefer", [True, False])
def test_a_persons_vote_outweighs_pictures_where_it_was_cast_and_nowhere_else(ball, prefer):
    """A patch within the shirt that a person calls skin, or not shirt."""
    scene, cameras, frame, tracked, faces = ball
    model = prepare(scene, cameras, [(frame, tracked)], faces, SegmentSettings())
    seen = evidence(frame, cameras, model, tracked, faces, SegmentSettings())
    far = np.linalg.norm(tracked.vertices - [0, -0.4, 1.3], axis=1)
    patch = np.flatnonzero(far < 0.12)
    vote = Vote(1 if prefer else 2, patch, prefer)
    before = segment(scene, seen, model, tracked, faces, SegmentSettings())
    after = segment(scene, seen, model, tracked, faces, SegmentSettings(), votes=[vote])
    assert (before.vertices[patch] == 2).all() and (after.vertices[patch] == 1).mean() > 0.95
    assert np.array_equal(before.vertices[far > 0.2], after.vertices[far > 0.2])


def test_an_island_on_the_tracked_surface_takes_the_label_around_it_unless_a_person_voted_for_it(ball):
    """Where the tracked surface floats off the scan, as at a web, and every picture calls the place skin."""
    scene, cameras, frame, tracked, faces = ball
    model = prepare(scene, cameras, [(frame, tracked)], faces, SegmentSettings())
    far = np.linalg.norm(tracked.vertices - CENTRE - RADIUS * np.array([0, -0.8, 0.6]), axis=1)
    place, patch = tracked.vertices[far.argmin()], np.flatnonzero(far < 0.035)
    V = tracked.vertices.copy()
    V[patch] += 0.03 * (V[patch] - CENTRE) / RADIUS
    images, labels = {}, {}
    for name, camera in cameras.items():
        at, depth = camera.project(place[None])
        disc = np.hypot(*(np.indices((512, 512))[::-1] - at[0][:, None, None])) < 0.035 * 560 / depth[0]
        disc &= (place - CENTRE) @ (camera.centre - place) > 0
        images[name] = np.where(disc[..., None], np.uint8([215, 165, 140]), frame.images[name])
        labels[name] = np.where(disc, np.uint8(1), frame.labels[name])
    spoilt, floating = replace(frame, images=images, labels=labels), replace(tracked, vertices=V)
    island = {}
    for least in (0.0, 0.01):
        settings = SegmentSettings(min_region=least)
        seen = evidence(spoilt, cameras, model, floating, faces, settings)
        island[least] = segment(scene, seen, model, floating, faces, settings).vertices[patch] == 1
    assert island[0.0].any() and not island[0.01].any()
    voted = segment(scene, seen, model, floating, faces, settings, votes=[Vote(1, patch, True)])
    assert (voted.vertices[patch] == 1).all()
