"""votes.json: a person's word on labels."""

import json
import shutil
from pathlib import Path

import pytest

from toile.errors import UserError
from toile.io.capture import check_capture, open_capture

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
GOOD = {"label": "tshirt", "vertices": [7, 3, 3], "prefer": True}


@pytest.fixture
def capture(tmp_path):
    return shutil.copytree(SAMPLE, tmp_path / "capture")


def opened(capture, votes):
    (capture / "votes.json").write_text(json.dumps(votes))
    return open_capture(capture)


def test_votes_are_read_and_count_as_a_file_of_the_scene(capture):
    assert open_capture(capture).votes == ()
    found = opened(capture, [GOOD, {"label": "skin", "vertices": [0], "forbid": True, "frames": [1, 2]}])
    first, second = found.votes
    assert (first.label, first.vertices.tolist(), first.prefer, first.frames) == (
        found.scene.labels["tshirt"],
        [3, 7],
        True,
        None,
    )
    assert not second.prefer and second.frames == (1, 2)
    assert capture / "votes.json" in found.files


@pytest.mark.parametrize(
    "change, said",
    [
        ({"label": "coat"}, r"votes.json: 0.label: 'coat' is not in scene.toml's \[labels\]"),
        ({"forbid": True}, 'votes.json: 0: expected one of "prefer": true and "forbid": true'),
        ({"prefer": False}, "expected one of"),
        ({"vertices": []}, "votes.json: 0.vertices"),
        ({"vertices": [1.5]}, "votes.json: 0.vertices.0"),
        ({"vertices": [-1]}, "0.vertices: -1 is no vertex"),
        ({"vertices": [3, 2**64]}, "0.vertices: 18446744073709551616 is no vertex"),
        ({"frames": [0, -1]}, "0.frames: -1 is no frame number"),
        ({"frames": []}, "votes.json: 0.frames"),
        ({"weight": 3}, "votes.json: 0.weight"),
    ],
)
def test_a_vote_that_is_none_is_refused_by_its_field(capture, change, said):
    with pytest.raises(UserError, match=said):
        opened(capture, [GOOD | change])


def test_a_vertex_that_the_surface_lacks_is_refused_before_the_run(capture):
    found = opened(capture, [GOOD | {"vertices": [10**6]}])
    with pytest.raises(UserError, match="votes.json: 0.vertices: 1000000: the surface has"):
        check_capture(found, found.frames)


def test_a_frame_that_the_capture_lacks_is_refused_before_the_run(capture):
    found = opened(capture, [GOOD | {"frames": [0, 999]}])
    with pytest.raises(UserError, match="votes.json: 0.frames: 999: the capture has no such frame"):
        check_capture(found, found.frames)


def test_what_is_no_list_is_refused(capture):
    with pytest.raises(UserError, match="votes.json"):
        opened(capture, {"label": "tshirt"})
