"""What commands show of their work where there is no terminal."""

from pathlib import Path

import pytest

from toile.console import ProgressLines, duration, frame_numbers, garments_of, numbers_of
from toile.errors import UserError


def test_a_log_gets_the_first_and_the_last_line_and_one_in_a_while_with_the_time_left(capsys):
    now = [0.0]
    progress = ProgressLines(every=30, clock=lambda: now[0])
    for done in range(101):  # 10 s each
        now[0] = 10.0 * done
        progress("track", done, 100)
    said = capsys.readouterr().err.splitlines()
    assert said[:3] == ["track: 0 of 100", "track: 3 of 100, about 16 min left", "track: 6 of 100, about 16 min left"]
    assert said[-1] == "track: 100 of 100" and len(said) == 35


def test_what_was_there_before_does_not_flatter_the_time_left(capsys):
    now = [0.0]
    progress = ProgressLines(every=30, clock=lambda: now[0])
    progress("track", 90, 100)
    now[0] = 60.0
    progress("track", 91, 100)
    assert capsys.readouterr().err.splitlines()[-1] == "track: 91 of 100, about 9 min left"


def test_a_quiet_log_says_nothing(capsys):
    progress = ProgressLines(quiet=True)
    progress("track", 0, 100)
    progress.print("a warning")
    assert capsys.readouterr() == ("", "")


def test_durations_are_said_in_words():
    assert [duration(s) for s in (40, 720, 12600)] == ["40 s", "12 min", "3.5 h"]


def test_frame_numbers_rise_and_each_comes_once_in_whatever_order_they_are_typed():
    for text in ("1-3,50,60", "60,1-3,50", "50,60,3,2,1", "2-3,1-3,60,50,60"):
        assert numbers_of(text) == frame_numbers(text, range(100)) == (1, 2, 3, 50, 60)
        assert frame_numbers(text, range(100), step=2) == (1, 3, 60)


def test_garments_are_read_as_a_name_and_the_avatar_that_each_is_taken_of():
    assert garments_of(None) == {}
    given = ["tshirt=runs/a=b", "trousers=other"]
    assert garments_of(given) == {"tshirt": Path("runs/a=b"), "trousers": Path("other")}


@pytest.mark.parametrize("text", ["tshirt", "tshirt=", "=other", ""])
def test_a_garment_without_a_name_or_an_avatar_is_refused(text):
    with pytest.raises(UserError, match=f"^--garment {text}: expected NAME=OTHER"):
        garments_of([text])


def test_a_garment_that_is_given_twice_is_refused():
    with pytest.raises(UserError, match="^--garment tshirt=b: tshirt is given twice"):
        garments_of(["tshirt=a", "tshirt=b"])


def test_a_stage_that_begins_anew_is_told_by_its_own_pace(capsys):
    now = [0.0]
    progress = ProgressLines(every=30, clock=lambda: now[0])
    for begin in (0, 1000):
        for done in (0, 50, 100):
            now[0] = begin + done
            progress("evaluate", done, 100)
    once = ["evaluate: 0 of 100", "evaluate: 50 of 100, about 50 s left", "evaluate: 100 of 100"]
    assert capsys.readouterr().err.splitlines() == once + once
