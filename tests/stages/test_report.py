"""The report in a real browser."""

import re
import shutil
import subprocess

import pytest

from test_pipeline import run  # noqa: F401  (the registered run is a fixture of that module)
from toile.report import write_report

FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --enable-logging=stderr --dump-dom"
).split()


def test_report_loads_in_a_browser_without_a_console_error(run, tmp_path):  # noqa: F811
    browser = shutil.which("chromium")
    if browser is None:
        pytest.skip("chromium is not installed")
    page = write_report(run, tmp_path / "report.html")
    text = page.read_text()
    assert not re.search(r"""(src|href)=['"](?!data:)""", text)
    loaded = subprocess.run(
        [browser, *FLAGS, f"--user-data-dir={tmp_path / 'profile'}", page.as_uri()], capture_output=True, text=True, timeout=120
    )
    assert loaded.returncode == 0
    assert "CONSOLE" not in loaded.stderr
    assert "frames registered" in loaded.stdout and loaded.stdout.count("<img") == 3 * 5
    assert loaded.stdout.count("<polyline") >= 10
