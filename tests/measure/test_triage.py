"""What the report's table says: which values are out, what only neighbours show, which frames are worst, and why."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.synthetic_run import SAMPLE
from toile.io.capture import open_capture
from toile.measure.triage import facts
from toile.measure.triage.advice import of_garment, title_of, trouble_of
from toile.measure.triage.between import Between, along, folded, labels_alike
from toile.measure.triage.columns import columns_of
from toile.measure.triage.measured import Row, _truth
from toile.measure.triage.outliers import FINE, GRAVE, OUT, levels, middle_and_edge
from toile.measure.triage.pictures import _captured, pictures
from toile.measure.verdicts import REASONS

GOOD = np.zeros(20, int)


def column(key):
    return columns_of([key])[0]


def level_of(key, values, states=GOOD, limits=None):
    values = np.array(values, np.float64)
    return levels(values, states, column(key), middle_and_edge(values, column(key))[1], limits)[0]


def test_a_difference_that_means_nothing_is_not_out_however_narrow_the_run_is():
    values = [0.223] * 19 + [0.228]
    assert not level_of("evidence:scan_to_surface_p50_mm", values).any()
    assert level_of("evidence:scan_to_surface_p50_mm", [0.223] * 19 + [5.0]).tolist() == [FINE] * 19 + [OUT]


def test_a_wide_run_has_no_outlier_within_its_own_spread():
    values = np.random.default_rng(0).gamma(4, 5, 2000)
    found = level_of("evidence:surface_to_scan_p95_mm", values, np.zeros(2000, int))
    assert (
        found.mean() < 0.002
        and level_of("evidence:surface_to_scan_p95_mm", [*values, 500], np.zeros(2001, int))[-1] == OUT
    )


def test_only_the_bad_side_is_out():
    assert level_of("evidence:observed", [80.0] * 19 + [20.0])[-1] == OUT
    assert level_of("evidence:observed", [20.0] * 19 + [80.0])[-1] == FINE
    assert level_of("evidence:pose_mm", [40.0] * 19 + [1.0])[-1] == FINE


def test_the_way_to_out_goes_from_the_median_and_is_one_there():
    for key, values, found in (
        ("evidence:observed", [80.0] * 17 + [90.0, 70.0, 60.0], [0.0, 1.0, 2.0]),  # floor 10
        ("evidence:pose_mm", [40.0] * 17 + [30.0, 48.0, 52.0], [0.0, 1.0, 1.5]),  # floor 8
    ):
        values = np.array(values)
        edge = middle_and_edge(values, column(key))[1]
        assert levels(values, GOOD, column(key), edge, None)[1][-3:] == pytest.approx(found)


def test_limits_of_what_is_good_when_large_are_met_from_above():
    values = [70.0] * 18 + [55.0, 35.0]
    assert level_of("evidence:silhouette_iou", values, np.full(20, 2), (60.0, 40.0)).tolist() == [FINE] * 18 + [
        OUT,
        GRAVE,
    ]


def test_where_most_frames_are_bad_the_limits_still_say_so_but_not_more_than_the_verdict():
    values, limits = [50.0] * 20, (20.0, 40.0)
    key = "dress tshirt:loop_mm.hem"
    assert level_of(key, values, np.full(20, 2), limits).tolist() == [GRAVE] * 20
    assert level_of(key, values, np.full(20, 1), limits).tolist() == [OUT] * 20
    assert level_of(key, values, GOOD, limits).tolist() == [FINE] * 20
    assert level_of("between:folded", [5.0] * 20, GOOD, column("between:folded").bounds).tolist() == [GRAVE] * 20


def test_where_no_value_can_be_out_nothing_is_said_to_be():
    low = column("evidence:observed")
    assert (
        middle_and_edge(np.array([5.0] * 20), low) == (5.0, None)
        and middle_and_edge(np.array([80.0] * 20), low)[1] == 70
    )


def test_values_that_are_not_known_are_never_out():
    found = level_of("evidence:pose_mm", [5.0] * 18 + [np.nan, 100.0])
    assert found.tolist() == [FINE] * 19 + [OUT]


def test_columns_are_words_and_a_mean_stands_in_for_the_median_of_older_runs():
    old = [c.words for c in columns_of(["evidence:scan_to_surface_mm", "track:searched", "evidence:observed"])]
    assert old == ["scan to body, mean", "body found on the scan"]
    both = columns_of(["evidence:scan_to_surface_mm", "evidence:scan_to_surface_p50_mm"])
    assert [c.words for c in both] == ["scan to body, median"]
    openings = columns_of(["dress tshirt:loop_mm.sleeve_left", "dress tshirt:loop_observed.sleeve_left"])
    assert [(c.words, c.unit) for c in openings] == [
        ("tshirt sleeve left: off", "mm"),
        ("tshirt sleeve left: seen", "%"),
    ]


# against neighbours ---------------------------------------------------------------------------------------------------


def fake_run(shape_of):
    """A run of one triangulated sphere as body and as garment, `shape_of(frame)` says where."""
    import trimesh

    ball = trimesh.creation.icosphere(3)
    V, F = np.array(ball.vertices), np.array(ball.faces, np.int32)
    surface = SimpleNamespace(at=lambda n: V + shape_of(n)[0], faces=F)
    garment = SimpleNamespace(at=lambda n: 1.1 * V @ np.array(shape_of(n)[1]).T + shape_of(n)[0], faces=F)
    model = SimpleNamespace(inside=np.zeros(len(V), bool), skin_faces=F, rest=lambda shape: (V, None))
    labels = SimpleNamespace(at=lambda n: (V[:, 2] > 0).astype(np.uint8))
    return SimpleNamespace(
        ok=[3, 4, 5, 9],
        track=surface,
        inner=surface,
        garments={"shirt": garment},
        labels=labels,
        body_model=model,
        shape=None,
    )


def turned(angle):
    c, s = np.cos(angle), np.sin(angle)
    return [[c, -s, 0], [s, c, 0], [0, 0, 1]]


def test_what_moves_evenly_neither_jumps_nor_swims():
    found = Between(fake_run(lambda n: (np.array([0.02 * n, 0, 0.01 * n]), np.eye(3)))).measures(4)
    assert found["jump_p95_mm"] == pytest.approx(0, abs=1e-9) and found["shirt.slip_mm"] == pytest.approx(0, abs=1e-9)
    assert found["labels_alike"] == 1 and found["folded"] == 0 and found["stretched"] == pytest.approx(1)


def test_a_jump_of_all_is_a_jump_and_no_swimming():
    found = Between(fake_run(lambda n: (np.array([0, 0, 0.03 * (n == 4)]), np.eye(3)))).measures(4)
    assert found["jump_p95_mm"] == pytest.approx(30) and found["shirt.jump_p95_mm"] == pytest.approx(30)
    assert found["shirt.slip_mm"] == pytest.approx(0, abs=1e-9)


def test_cloth_that_turns_over_a_still_body_for_a_frame_swims():
    found = Between(fake_run(lambda n: (np.zeros(3), turned(0.01 * (n == 4))))).measures(4)
    radius = 1.1 * np.mean(np.hypot(*np.array(fake_run(lambda n: (np.zeros(3), np.eye(3))).track.at(0)).T[:2]))
    assert found["shirt.slip_mm"] == pytest.approx(1e3 * 0.01 * radius, rel=0.01) and found["jump_p95_mm"] == 0


def test_a_frame_without_both_neighbours_has_no_jump():
    between = Between(fake_run(lambda n: (np.zeros(3), np.eye(3))))
    assert "jump_p95_mm" not in between.measures(3) and "labels_alike" in between.measures(3)
    assert set(between.measures(9)) == {"folded", "stretched", "shirt.folds"}


def test_labels_alike_is_that_of_the_worst_label_and_small_ones_are_left_out():
    here, there = np.repeat([0, 1, 2], [1000, 996, 4]), np.repeat([0, 1, 3], [500, 1496, 4])
    assert labels_alike(here, [there]) == pytest.approx(500 / 1000)
    assert labels_alike(here, [there, here]) == pytest.approx(0.75)
    assert labels_alike(np.arange(1000), [np.arange(1000)]) is None


def test_a_triangle_turned_inside_out_is_folded_and_a_plane_has_no_part_along_its_normal():
    n = 20
    V = np.stack([*np.meshgrid(np.arange(n), np.arange(n)), np.zeros((n, n))], -1).reshape(-1, 3).astype(np.float64)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    F = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)]).astype(np.int32)
    assert folded(V, F) == 0
    V[n * 10 + 10] += [3.0, 0, 0]  # over its neighbours
    assert 0 < folded(V, F) < 0.02
    assert np.allclose(along(np.array([[1.0, 2, 3]]), np.array([[0, 0, 1.0]])), [[1, 2, 0]])


# why, and what to do --------------------------------------------------------------------------------------------------


def test_every_reason_of_a_verdict_has_an_advice_of_its_own():
    reasons = [words.format("12") for words in REASONS.values()]
    found = [
        trouble_of(f"tshirt: {reason} (at most 3 is good)")
        for reason in [*reasons, "no scan shows where the surface lies"]
    ]
    assert None not in found and len({trouble.title for trouble in found}) == len(found)
    assert (
        of_garment("tshirt.hem: 1.4 times as long as the sampled frames show the opening, or as short") == "tshirt hem"
    )
    assert of_garment("tshirt: an opening lies 28 mm from the one that was seen") == "tshirt"
    assert title_of("frames/000003/scan.ply: truncated at 4012 bytes") == title_of(
        "frames/000017/scan.ply: truncated at 99 bytes"
    )


def test_every_limit_of_a_verdict_has_a_column_to_be_seen_in():
    limits = set(REASONS)
    keys = [f"evidence:{of}{name}" for name in limits for of in ("", "tshirt.", "tshirt.hem.")] + [
        "dress tshirt:loop_mm.hem"
    ]
    assert {c.limit for c in columns_of(keys)} - {""} == limits


def rows(count=40):
    """Frames of which 7 and 8 are wrong, 20 failed, 30 jumps."""
    found = [Row(n, 0, (), {"evidence:pose_mm": 5.0, "between:jump_p95_mm": 3.0}) for n in range(count)]
    for n in (7, 8):
        found[n] = Row(
            n,
            2,
            ("scan and surface lie 45 mm apart, from whichever side (at most 12 is good)",),
            {"evidence:pose_mm": 90.0 + n},
        )
    found[20] = Row(20, 3, ("frames/000020/scan.ply: truncated",), {})
    found[30] = Row(30, 0, (), {"evidence:pose_mm": 5.0, "between:jump_p95_mm": 70.0})
    return found


def test_failed_frames_come_first_then_wrong_ones_then_those_unlike_the_run_then_the_rest():
    made = rows()
    columns = facts.values_of(made, {"verdict": {"pose_mm": [40.0, 60.0]}})
    reasons = facts.reasons_of(made, columns)
    assert facts.ranking(made, columns, reasons)[:4] == [20, 8, 7, 30]
    assert reasons[30] == ["body: jump, 95\u00a0%: 70 mm, the run's median is 3 mm"] and reasons[31] == []
    titles = [(t["title"], t["rows"]) for t in facts.troubles(made, reasons)]
    assert titles[0][1] == [20] and titles[1] == ("scan and surface lie apart", [7, 8]) and titles[2][1] == [30]
    pose = next(c for c in columns if c.column.key == "evidence:pose_mm")
    assert pose.level[[7, 8, 30]].tolist() == [GRAVE, GRAVE, FINE]


def test_pictures_are_of_every_trouble_before_they_are_of_its_neighbours():
    made = rows()
    columns = facts.values_of(made, {})
    reasons = facts.reasons_of(made, columns)
    order = facts.ranking(made, columns, reasons)
    assert facts.shown(order, made, reasons, 3) == [20, 8, 30]
    assert (
        sorted(facts.shown(order, made, reasons, 4)) == [7, 8, 20, 30]
        and len(facts.shown(order, made, reasons, 20)) == 20
    )


def test_a_picture_is_shown_whatever_lies_beside_it(tmp_path):
    folder = shutil.copytree(SAMPLE, tmp_path / "capture", ignore=shutil.ignore_patterns("truth"))
    (folder / "frames" / "000000" / "images" / "cam00.CR2").write_bytes(b"as the camera wrote it")
    said = []
    ((name, picture),) = _captured(SimpleNamespace(capture=open_capture(folder)), 0, [], said.append)
    assert name == "cam00" and picture.shape == (*open_capture(SAMPLE).cameras["cam00"].size, 3) and not said


def test_files_of_a_frame_that_can_no_more_be_read_are_named(tmp_path):
    folder = shutil.copytree(SAMPLE, tmp_path / "capture", ignore=shutil.ignore_patterns("truth"))
    (image,) = (folder / "frames" / "000000" / "images").glob("cam00.*")
    image.write_bytes(b"cut")
    (folder / "frames" / "000000" / "scan.ply").write_bytes(b"cut")
    capture, said = open_capture(folder), []
    run = SimpleNamespace(capture=capture, ok=[], scene=capture.scene)
    assert pictures(run, 0, said.append) == [] and len(said) == 2
    assert all(path in text for path, text in zip(("cam00.", "scan.ply"), said))


def test_a_truth_that_cannot_be_read_is_named_and_nothing_is_measured_against_it(tmp_path):
    folder = shutil.copytree(SAMPLE, tmp_path / "capture")
    (folder / "truth" / "truth.zarr" / "zarr.json").write_text("{")
    result = _truth(SimpleNamespace(capture=open_capture(folder)), {}, {})["result"]
    assert result.keys() == {"warnings"} and str(folder / "truth") in result["warnings"][0]


def test_the_command_names_the_run_its_settings_and_all_its_frames():
    run = SimpleNamespace(config={"capture": "/data/a b"}, path="/out/run")
    assert (
        facts.command(run, [0, 1, 2, 5])
        == "toile register '/data/a b' /out/run --config /out/run/config.toml --frames 0-2,5"
    )
    assert facts.command(SimpleNamespace(config={"capture": "x", "align": {}}, path="r"), [0]) == ""
