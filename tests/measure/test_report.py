"""The report: read, not computed again, and its page in a real browser."""

import csv
import json
import re
import shlex
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.browser import Browser
from tests.support.long_run import long_run
from toile.errors import UserError
from toile.io.run import open_run
from toile.io.run_folder import diagnostics_file, read_diagnostics, write_diagnostics
from toile.measure import report
from toile.measure.page import HEAT, heat, plot, short_number, table
from toile.measure.report import write_report
from toile.measure.triage import facts, measured
from toile.measure.triage.measured import Row

FRAMES, EVIL = 36, "<img src=x onerror=alert(1)></script>"


@pytest.fixture(scope="module")
def long(sample_run, tmp_path_factory):
    """A run of FRAMES frames and its page, with pictures of the worst four; one reason is hostile."""
    run = long_run(sample_run, tmp_path_factory.mktemp("long"), FRAMES)
    opened = open_run(run)
    frame = int(opened.frames[np.flatnonzero((opened.verdict == 2) & (opened.done == 1))[0]])
    write_diagnostics(run, frame, read_diagnostics(run, frame) | {"reasons": [EVIL]})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "WORST", 4)
        return SimpleNamespace(run=run, page=write_report(run), evil=frame, opened=opened)


def test_what_the_run_holds_is_read_and_what_is_made_is_made_once(long, monkeypatch):
    rows, _ = measured.measured(long.opened)
    kept = json.loads((long.run / "measured.json").read_text())
    assert {int(n) for n in kept["frames"]} == set(long.opened.ok)
    asked = []
    monkeypatch.setattr(measured.Between, "measures", lambda self, number: asked.append(number) or {"folded": 0.5})
    monkeypatch.setattr(measured, "evaluate", lambda run: pytest.fail("there is no truth"))
    again, _ = measured.measured(long.opened)
    assert asked == [] and again == rows
    number = next(n for n in long.opened.ok if n > 2 and {n - 1, n + 1} <= set(long.opened.ok))
    path, before = diagnostics_file(long.run, number), read_diagnostics(long.run, number)
    write_diagnostics(long.run, number, before | {"given": {"again": 1.0}})
    changed, _ = measured.measured(long.opened)
    assert asked == [number - 1, number, number + 1]
    assert changed[number].values["between:folded"] == 0.5
    write_diagnostics(long.run, number, before)
    (long.run / "measured.json").write_text(json.dumps(kept))
    assert path.exists()


def test_a_run_that_may_not_be_written_into_is_reported_elsewhere(long, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "WORST", 0)

    def refused(path, text):
        raise OSError(30, "read-only", str(path))

    monkeypatch.setattr(measured, "write_text", refused)
    (long.run / "measured.json").rename(tmp_path / "kept.json")
    assert write_report(long.run, tmp_path / "page.html").exists()
    (tmp_path / "kept.json").rename(long.run / "measured.json")


def test_the_table_lies_beside_the_page_twice_and_says_the_same(long):
    told = json.loads((long.run / "report.json").read_text())
    with open(long.run / "report.csv", newline="", encoding="utf-8") as file:
        head, *lines = list(csv.reader(file))
    assert head[:3] == ["frame", "verdict", "reasons"] and len(lines) == len(told["frames"]) == FRAMES
    assert not any(re.search(r"_mm|_p95|evidence", name) for name in head)
    words = [f"{c['group']}: {c['words']}" + (f" [{c['unit']}]" if c["unit"] else "") for c in told["columns"]]
    assert head[3:] == words
    for line, frame in zip(lines, told["frames"]):
        assert (int(line[0]), line[1]) == (frame["frame"], frame["verdict"])
        values = [None if text == "" else float(text) for text in line[3:]]
        assert values == [frame["values"][c["key"]] for c in told["columns"]]
    with pytest.raises(UserError, match=r"report\.csv: the page's table is written there"):
        write_report(long.run, long.run / "report.csv")


def test_a_truth_adds_its_errors_and_they_are_kept(sample_run, tmp_path, monkeypatch):
    run = tmp_path / "run"
    shutil.copytree(sample_run, run)
    monkeypatch.setattr(report, "WORST", 1)
    page = write_report(run)
    told = json.loads((run / "report.json").read_text())
    assert "Against the truth" in {c["group"] for c in told["columns"]} and told["all"]["joint_mm"] > 0
    monkeypatch.setattr(measured, "evaluate", lambda run: pytest.fail("it has been evaluated"))
    text = page.read_text()
    write_report(run)
    assert page.read_text() == text


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if shutil.which("chromium") is None:
        pytest.skip("chromium is not installed")
    with Browser(tmp_path_factory.mktemp("profile")) as found:
        yield found


def test_the_page_opens_from_its_file_alone_sorts_filters_and_selects(long, browser):
    assert not re.search(r"""(src|href)=['"](?!data:)""", long.page.read_text())
    browser.errors.clear()
    browser.open(long.page.as_uri(), "globalThis.triage")
    frames = lambda: browser.run("triage.view().map(i => triage.data.frames[i])")
    verdicts = long.opened.verdict.tolist()
    failed = [n for n, done in zip(long.opened.frames.tolist(), long.opened.done.tolist()) if done == 2]
    first = frames()
    assert len(first) == FRAMES and first[: len(failed)] == failed and verdicts[first[len(failed)]] == 2
    assert browser.run("document.querySelectorAll('#table tbody tr[data-row]').length") <= FRAMES

    column = "triage.data.columns.find(c => c.words === 'pose to scan')"
    values = {n: read_diagnostics(long.run, n)["evidence"]["pose_mm"] for n in long.opened.ok}
    browser.run(f"triage.sort({column})")
    assert (
        frames()[: -len(failed)] == sorted(values, key=lambda n: -float(f"{values[n]:.5g}")) and frames()[-1] in failed
    )
    browser.run(f"triage.sort({column})")
    assert frames()[0] == min(values, key=values.get)
    middle = float(np.median(list(values.values())))
    browser.run(f"(() => {{ triage.filters.set({column}, '> {middle:.4f}'); triage.refresh(); }})()")
    assert set(frames()) == {n for n, value in values.items() if float(f"{value:.5g}") > round(middle, 4)}
    browser.run("document.getElementById('clear').click()")
    browser.run("(() => { triage.filters.set('why', 'doubtful'); triage.refresh(); })()")
    assert {verdicts[n] for n in frames()} == {1}
    browser.run("document.getElementById('clear').click()")
    browser.run("[...document.querySelectorAll('#states button')].find(b => b.textContent.endsWith('wrong')).click()")
    assert set(frames()) == {n for n, v in enumerate(verdicts) if v == 2 and n not in failed}

    browser.run("document.getElementById('clear').click()")
    key = lambda name: browser.run(
        f"document.getElementById('scroll').dispatchEvent(new KeyboardEvent('keydown', {{key: '{name}'}}))"
    )
    for name in ("Home", "ArrowDown", " ", "ArrowDown", " "):
        key(name)
    assert browser.run("[...triage.picked].map(i => triage.data.frames[i])") == first[1:3]
    assert browser.run("document.querySelectorAll('#table tr.picked').length") == 2
    key("Escape")
    browser.run("[3, 4, 5, 9].forEach(i => triage.picked.add(i))")
    command = shlex.split(browser.run("triage.commandFor([...triage.picked])"))
    again = [
        "toile",
        "register",
        long.opened.config["capture"],
        str(long.run),
        "--config",
        str(long.run / "config.toml"),
    ]
    assert command == [*again, "--frames", f"0-{FRAMES - 1}", "--retry", "3-5,9"]
    assert browser.errors == []


def test_pictures_are_decoded_when_they_come_into_sight_and_texts_stay_texts(long, browser):
    browser.errors.clear()
    browser.open(long.page.as_uri(), "globalThis.triage")
    row = browser.run(f"triage.data.frames.indexOf({long.evil})")
    browser.run(f"triage.go({row})")
    assert browser.run("document.getElementById('detail').textContent").count(EVIL) == 1
    assert browser.run("document.querySelectorAll('img[src=x]').length") == 0
    waiting = browser.run("[...document.images].filter(i => !i.src).length")
    browser.run("(async () => { scrollTo(0, document.body.scrollHeight); for (let k = 0; k < 2000 &&"
                " [...document.querySelectorAll('.bad:last-child img')].some(i => !i.src); k++) await new Promise(r => setTimeout(r, 50)); })()")  # fmt: skip
    assert browser.run("[...document.images].filter(i => !i.src).length") < waiting
    captions = browser.run("[...document.querySelectorAll('.bad:last-child figcaption')].map(f => f.textContent)")
    assert [c for c in captions if c in long.opened.capture.cameras] and {"scan, front", "scan, back"} <= set(captions)
    assert browser.errors == []


def test_a_run_of_which_every_frame_failed_has_a_page(long, browser, tmp_path):
    rows = [Row(n, 3, (f"frames/{n:06d}/scan.ply: truncated",), {}) for n in range(3)]
    page = tmp_path / "page.html"
    page.write_text(report.page(long.opened, rows, [], facts.reasons_of(rows, []), [0, 1, 2], [(0, [])], {}, ""))
    browser.errors.clear()
    browser.open(page.as_uri(), "globalThis.triage")
    assert browser.run("triage.view().length") == 3 and browser.errors == []
    assert "3 failed" in browser.run("document.getElementById('troubles').textContent")


@pytest.fixture(scope="module")
def five_thousand(long, tmp_path_factory):
    """The page of 5,000 frames with all columns of the long run and 20 times six pictures of 30 kB."""
    draw, keys = (
        np.random.default_rng(0),
        [c["key"] for c in json.loads((long.run / "report.json").read_text())["columns"]],
    )
    why = ("an opening lies 28 mm from the one that was seen (at most 20 is good)",)
    states = draw.choice(4, 5000, p=[0.9, 0.06, 0.03, 0.01]).tolist()
    rows = [
        Row(n, state, why * (state > 0), {key: float(draw.gamma(4, 1)) for key in keys})
        for n, state in enumerate(states)
    ]
    columns = facts.values_of(rows, {})
    reasons = facts.reasons_of(rows, columns)
    made = [(i, [("scan, front", draw.bytes(30_000))] * 6) for i in range(20)]
    text = report.page(long.opened, rows, columns, reasons, facts.ranking(rows, columns, reasons), made, {}, "")
    page = tmp_path_factory.mktemp("five") / "page.html"
    page.write_text(text)
    return page


READY = "globalThis.triage?.view().length === 5000"


def test_five_thousand_frames_are_under_20_mb_and_few_rows_are_elements(five_thousand, browser):
    assert five_thousand.stat().st_size < 20e6
    browser.errors.clear()
    browser.open(five_thousand.as_uri(), READY)
    assert browser.run("document.querySelectorAll('#table tr').length") < 100
    rows = "[...document.querySelectorAll('#table tr[data-row]')].map(r => +r.getAttribute('aria-rowindex'))"
    shown = browser.run(  # drawn with the next picture, which a busy machine may be late with
        "(async () => { document.getElementById('scroll').scrollTop = 28 * 4000;"
        f" for (let i = 0; i < 1000 && Math.min(...{rows}) < 1000; i++) await new Promise(r => setTimeout(r, 100));"
        f" return {rows}; }})()"
    )
    assert len(shown) < 100 and min(shown) > 3900 and max(shown) < 4100
    assert browser.errors == []


@pytest.mark.slow(seconds=10)
def test_five_thousand_frames_are_painted_within_two_seconds(five_thousand, browser):
    entry = "performance.getEntriesByName('first-contentful-paint')[0]"
    painted, ready = [], []
    for _ in range(3):  # other work on the machine is not the page's
        browser.open("about:blank", "true")
        browser.open(five_thousand.as_uri(), f"{READY} && {entry}")
        painted.append(browser.run(f"{entry}.startTime") / 1e3)
        ready.append(browser.run("performance.getEntriesByName('table')[0].startTime") / 1e3)
    print(f"{five_thousand.stat().st_size / 1e6:.1f} MB, first paint {min(painted):.2f} s, table {min(ready):.2f} s")
    assert min(painted) < 2


def test_heat_runs_from_the_first_colour_to_the_last_and_stays_there():
    colours = heat(np.array([0, 0.5, 1, 1000]))
    assert np.allclose(colours, [HEAT[0], HEAT[2], HEAT[-1], HEAT[-1]])


def test_numbers_are_printed_without_an_exponent():
    assert [short_number(v) for v in (3, 0.0, 1.23456, 12345.6, 3e-9)] == ["3", "0", "1.23", "12346", "under 0.001"]


def test_a_table_escapes_its_texts():
    assert table(["<b>"], [["&", None, 0.25]]).count("&lt;b&gt;") == 1
    assert "<td>&amp;</td><td>\u2013</td><td>0.25</td>" in table(["<b>"], [["&", None, 0.25]])


def test_the_title_of_a_plot_stays_inside_it():
    svg = plot("garment " + "x" * 200 + " boundary_mm hem", [(0, 1.0), (1, 2.0)])
    title = re.search(r"<text x='6' y='16'>(.*?)</text>", svg).group(1)
    assert len(title) <= 50 and title.endswith("boundary hem")
