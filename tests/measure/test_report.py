"""The report in a real browser."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from toile.measure.page import HEAT, heat, plot, short_number, table
from toile.measure.report import write_report

FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --enable-logging=stderr --dump-dom"
).split()


def test_report_loads_in_a_browser_without_a_console_error(sample_run, tmp_path):
    browser = shutil.which("chromium")
    if browser is None:
        pytest.skip("chromium is not installed")
    page = write_report(sample_run, tmp_path / "report.html")
    text = page.read_text()
    assert not re.search(r"""(src|href)=['"](?!data:)""", text)
    loaded = subprocess.run(
        [browser, *FLAGS, f"--user-data-dir={tmp_path / 'profile'}", page.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert loaded.returncode == 0
    assert "CONSOLE" not in loaded.stderr
    assert "frames registered" in loaded.stdout and loaded.stdout.count("<img") == 4 * 9
    assert loaded.stdout.count("<polyline") >= 10


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
