"""`toile register --check`: every file of every frame is read, every bad one is named, nothing is made."""

import json
import shutil
from pathlib import Path

import pytest

from toile import cli
from toile.io.capture import open_capture
from toile.io.faults import faults

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


@pytest.fixture
def spoilt(tmp_path):
    """The bundled capture with five bad files in three frames, and a frame without anything."""
    capture = tmp_path / "capture"
    shutil.copytree(SAMPLE, capture)
    frames = capture / "frames"
    cut(frames / "000001" / "images" / "cam03.jpg")
    cut(next((frames / "000001" / "masks").iterdir()))
    cut(frames / "000003" / "scan.ply")
    (frames / "000003" / "keypoints.json").write_text("{")
    (frames / "000004" / "labels" / "cam00.png").unlink()
    (frames / "000004" / "labels" / "cam77.png").write_bytes(b"")
    (frames / "000010").mkdir()
    return capture


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def test_every_bad_file_is_named_and_no_sound_one(spoilt):
    capture = open_capture(spoilt)
    found = dict(faults(capture, capture.frames))
    assert [number for number, lines in found.items() if lines] == [1, 3, 4, 10]
    named = {number: sorted(str(Path(line.split(":")[0]).relative_to(spoilt / "frames")) for line in lines)
             for number, lines in found.items() if lines}  # fmt: skip
    mask = next((spoilt / "frames" / "000001" / "masks").iterdir()).name
    assert named == {
        1: ["000001/images/cam03.jpg", f"000001/masks/{mask}"],
        3: ["000003/keypoints.json", "000003/scan.ply"],
        4: ["000004/labels/cam77.png"],
        10: ["000010"],
    }


@pytest.mark.parametrize(("frames", "code", "bad"), [("0,2", 0, 0), ("0-3", 1, 4)])
def test_the_command_says_so_by_its_exit_code_and_makes_nothing(
    monkeypatch, capsys, tmp_path, spoilt, frames, code, bad
):
    run = tmp_path / "run"
    monkeypatch.setattr(
        "sys.argv", ["toile", "register", str(spoilt), str(run), "--check", "--json", "--frames", frames]
    )
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert (stop.value.code or 0) == code and not run.exists()
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert sum(line["event"] == "frame" for line in lines) == bad
    (result,) = [line for line in lines if line["event"] == "result"]
    assert sum(map(len, result["bad"].values())) == bad
