"""A folder of results is there whole or not at all."""

import pytest

from toile.errors import UserError
from toile.io.files import whole_folder


def test_a_folder_is_there_whole_or_not_at_all(tmp_path):
    with pytest.raises(KeyError), whole_folder(tmp_path / "out") as folder:
        (folder / "a").write_text("half")
        raise KeyError
    assert not list(tmp_path.iterdir())
    with whole_folder(tmp_path / "out") as folder:
        (folder / "a").write_text("all")
        assert not (tmp_path / "out").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["out"] and (tmp_path / "out" / "a").read_text() == "all"


def test_a_message_about_the_folder_calls_it_by_its_name(tmp_path):
    with pytest.raises(UserError, match=f"^{tmp_path}/out/a: bad$"), whole_folder(tmp_path / "out") as folder:
        raise UserError(f"{folder / 'a'}: bad")


def test_of_two_writers_of_one_place_the_first_to_end_wins_and_the_other_is_refused(tmp_path):
    with pytest.raises(UserError, match="out: exists already and is not empty"), whole_folder(tmp_path / "out") as late:
        (late / "a").write_text("late")
        with whole_folder(tmp_path / "out") as first:
            (first / "a").write_text("first")
        assert (late / "a").read_text() == "late"
    assert [p.name for p in tmp_path.iterdir()] == ["out"] and (tmp_path / "out" / "a").read_text() == "first"
