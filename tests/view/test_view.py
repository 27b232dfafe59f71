"""`toile view`: the bytes it sends, what it refuses, and the page in a real browser."""

import http.client
import io
import json
import shutil
import struct
import threading
from contextlib import contextmanager

import numpy as np
import pytest
import zarr
from PIL import Image

from tests.support.bending_clip import bending_clip, write_animation
from tests.support.browser import Browser
from tests.support.synthetic_run import SAMPLE, copy_capture, true_run
from toile.errors import UserError
from toile.io.run import open_run
from toile.view.command import view
from toile.view.server import serve
from toile.view.shown import FARTHEST, Shown


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Six frames of the bundled capture: the third failed, the fifth is doubtful."""
    folder = tmp_path_factory.mktemp("viewed")
    run = true_run(copy_capture(folder), folder)
    store = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    store["done"][2], store["verdict"][:] = 2, [0, 0, 2, 0, 1, 0]
    return run


@contextmanager
def served(*paths):
    server = serve([Shown(path) for path in paths], 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield server.server_address
    finally:
        server.shutdown()
        server.server_close()


def get(address, path, **headers):
    connection = http.client.HTTPConnection(*address)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    return answer.status, answer.read(), answer


def unpacked(data):
    """The points (n,3) of what `quantised` made."""
    low, step = np.frombuffer(data, "<f4", 6).reshape(2, 3).astype(float)
    return low + step * np.frombuffer(data, "<u2", offset=24).reshape(-1, 3)


@pytest.mark.parametrize(
    "left, said",
    [
        (["checkpoints"], "taken for an avatar by its checkpoints, but it lacks avatar.json"),
        (
            ["config.toml", "diagnostics"],
            "taken for a run by its config.toml and diagnostics, but it lacks registered.zarr",
        ),
        (["meshes"], "taken for an animation by its meshes, but it lacks animation.json"),
        (["frames"], "taken for a capture by its frames, but it lacks scene.toml"),
        (
            [],
            "there is nothing to view; expected one of avatar.json of an avatar, registered.zarr of a run, animation.json of",
        ),
    ],
)
def test_a_folder_that_is_nothing_to_view_is_told_what_it_is_taken_for_and_lacks(tmp_path, left, said):
    for name in left:
        (tmp_path / name).mkdir()
    with pytest.raises(UserError) as error:
        view(tmp_path, browser=False)
    assert str(error.value).startswith(f"{tmp_path}: {said}") and "\n" not in str(error.value)


def test_points_are_within_a_twentieth_of_a_millimetre(run):
    shown, opened = Shown(run), open_run(run)
    for layer in (opened.inner, opened.garments["tshirt"]):
        data = shown.points(layer.name, 3)
        assert np.abs(unpacked(data) - layer.at(3)).max() < 5e-5 and len(data) == 24 + 6 * len(layer.at(3))
        assert np.array_equal(np.frombuffer(shown.faces(layer.name), "<u4").reshape(-1, 3), layer.faces)


def test_the_scan_is_sent_whole_and_colours_are_distances_to_it(run):
    shown = Shown(run)
    scan, data = shown.capture.frame(3).scan, shown.scan(3)
    n, m = struct.unpack("<2I", data[:8])
    assert (n, m) == (len(scan.vertices), len(scan.faces))
    assert np.abs(unpacked(data[8 : 8 + 24 + 6 * n]) - scan.vertices).max() < 5e-5
    assert np.array_equal(np.frombuffer(data[-12 * m :], "<u4").reshape(-1, 3), scan.faces)
    shares = np.frombuffer(shown.colours("tshirt", "distance to the scan", 3), np.uint8) / 255
    distance = scan.index.closest(open_run(run).garments["tshirt"].at(3))[3]
    assert np.abs(shares - np.clip(distance / FARTHEST, 0, 1)).max() < 1 / 255


def test_the_true_run_lies_on_the_truth(run):
    shown = Shown(run)
    for layer in ("inner", "tshirt"):
        assert "distance to the truth" in next(f["colours"] for f in shown.facts()["layers"] if f["name"] == layer)
        assert max(shown.colours(layer, "distance to the truth", 3)) == 0
    with pytest.raises(UserError, match="track has no colours 'distance to the truth' in frame 3"):
        shown.colours("track", "distance to the truth", 3)


def test_colours_are_offered_where_the_truth_has_the_layer(tmp_path):
    capture = copy_capture(tmp_path)
    run = true_run(capture, tmp_path)
    shutil.rmtree(capture / "truth" / "truth.zarr" / "garment")
    offered = {layer["name"]: "distance to the truth" in layer["colours"] for layer in Shown(run).facts()["layers"]}
    assert offered == {"track": False, "inner": True, "tshirt": False}


def test_marks_name_bad_frames_and_pictures_are_small(run):
    shown = Shown(run)
    facts = json.loads(json.dumps(shown.facts()))
    assert facts["marks"] == {"2": "failed", "4": "doubtful"} and facts["frames"] == [0, 1, 3, 4, 5]
    assert [layer["name"] for layer in facts["layers"] if layer["shown"]] == ["inner", "tshirt"]
    camera = facts["cameras"][0]
    image = Image.open(io.BytesIO(shown.picture(camera["name"], 0)))
    assert image.format == "JPEG" and max(image.size) <= 720
    assert image.size[0] / image.size[1] == pytest.approx(camera["width"] / camera["height"], rel=0.01)


def test_a_picture_is_shown_whatever_lies_beside_it(tmp_path):
    capture = shutil.copytree(SAMPLE, tmp_path / "capture", ignore=shutil.ignore_patterns("truth"))
    (capture / "frames" / "000000" / "images" / "cam00.CR2").write_bytes(b"as the camera wrote it")
    assert Shown(capture).picture("cam00", 0) == Shown(SAMPLE).picture("cam00", 0)


def test_a_capture_is_shown_without_layers():
    facts = Shown(SAMPLE).facts()
    assert facts["layers"] == [] and facts["scan"] and facts["frames"][:2] == [0, 1]


class Puppet:
    """The bending clip, which "lift" raises by a metre at 90 degrees."""

    turns = ["lift"]
    warnings = ("the motion lacks wings: they rest",)

    def __init__(self):
        self.clip = bending_clip()

    def vertices(self, frame, turns):
        lift = [0, 0, turns.get("lift", 0.0) / (np.pi / 2)]
        return {layer.name: layer.at(frame) + lift for layer in self.clip.layers}


def test_what_the_page_cannot_show_is_said(run, tmp_path, monkeypatch, capsys):
    assert Shown(run).warnings == [] and Shown(SAMPLE).warnings == []
    moved = shutil.copytree(run, tmp_path / "moved")
    (moved / "config.toml").write_text('capture = "/not/there"\n')
    zarr.open_group(str(moved / "registered.zarr"), mode="r+")["done"][5] = 0
    pending, gone = Shown(moved).warnings
    assert pending == f"{moved}: 1 of 6 frames are not registered yet: they are not shown"
    assert gone.startswith(
        "scans, cameras and pictures are not shown: /not/there: the capture is gone; where it was moved"
    )
    monkeypatch.setattr("toile.view.command.posable", lambda *_, **__: Puppet())
    monkeypatch.setattr("toile.view.server.serve", lambda *_: (_ for _ in ()).throw(UserError("served")))
    with pytest.raises(UserError, match="served"):
        view(tmp_path, browser=False)
    assert "warning: the motion lacks wings: they rest" in capsys.readouterr().err


def test_a_clip_is_played_as_long_as_it_lasts_whatever_the_step_of_its_frames(tmp_path):
    for folder, frames, pictures in (("each", (3, 4, 5, 7), 25), ("fifth", (0, 5, 10, 20), 5)):
        write_animation(bending_clip(frames), tmp_path / folder)
        assert Shown(tmp_path / folder).facts()["rate"] == pictures  # a second


def test_poses_are_degrees_by_name_and_others_are_refused(tmp_path):
    shown = Shown(tmp_path, Puppet())
    for angle in (90, -45):
        V = unpacked(shown.posed("inner", f"lift:{angle}", 4))
        assert np.abs(V - Puppet().clip.layers[0].at(4) - [0, 0, angle / 90]).max() < 5e-5
    for pose in ("lift", "lift:x", "lift:nan", "lift:999"):
        with pytest.raises(UserError, match="no pose|-180 to 180"):
            shown.posed("inner", pose, 4)
    write_animation(Puppet().clip, tmp_path)
    with pytest.raises(UserError, match="nothing that can be posed"):
        Shown(tmp_path).posed("inner", "lift:1", 4)


def test_only_this_machine_is_answered_and_only_what_is_shown(run):
    with served(run) as address:
        assert address[0] == "127.0.0.1"
        assert get(address, "/")[0] == 200 and get(address, "/facts")[0] == 200
        assert get(address, "/facts", Host="localhost")[0] == 200  # as browsers write port 80
        for foreign in ("evil.example:80", "evil.example", "127.0.0.1.evil.example", ""):
            assert get(address, "/facts", Host=foreign)[0] == 403
        for path in (
            "/../config.toml", "/view.html", "/0/points/tshirt/2", "/0/points/hat/1", "/1/points/tshirt/1", "/0/layer/tshirt",
            "/0/picture/..%2F..%2Fscene/1", "/0/colours/tshirt/nothing/1", "/0/points/tshirt/x", "/0", "/x",
        ):  # fmt: skip
            status, body, _ = get(address, path)
            assert status == 404 and b"Traceback" not in body, path
        policy = get(address, "/")[2].headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy and "http" not in policy
        with pytest.raises(UserError, match=f"--port {address[1]}"):
            serve([], address[1])


def test_a_fault_of_its_own_is_told(monkeypatch, capsys):
    def broken(self):
        raise RuntimeError("a layer is missing")

    monkeypatch.setattr(Shown, "facts", broken)
    with served(SAMPLE) as address, pytest.raises(http.client.RemoteDisconnected):
        get(address, "/facts")
    assert "RuntimeError: a layer is missing" in capsys.readouterr().err


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if shutil.which("chromium") is None:
        pytest.skip("chromium is not installed")
    with Browser(tmp_path_factory.mktemp("profile")) as found:
        yield found


PIXELS = """(() => { view.draw(); const gl = document.getElementById('scene').getContext('webgl2'), w = gl.drawingBufferWidth,
  p = new Uint8Array(4 * w); let sum = 0; for (let y = 0; y < gl.drawingBufferHeight; y += 7) {
  gl.readPixels(0, y, w, 1, gl.RGBA, gl.UNSIGNED_BYTE, p); for (const v of p) sum = (sum * 31 + v) % 4294967291; } return sum; })()"""


def test_the_page_shows_frames_layers_scan_and_cameras_without_an_error(run, browser):
    with served(run) as (host, port):
        browser.errors.clear()
        browser.open(f"http://{host}:{port}/", "globalThis.view")
        seen = {"first": browser.run(PIXELS)}
        assert browser.run("document.getElementById('number').textContent") == "frame 0"
        browser.run("view.show(4)")
        assert browser.run("document.getElementById('number').textContent") == "frame 4: doubtful"
        seen["later"] = browser.run(PIXELS)
        for label in ("tshirt", "scan", "cameras"):
            browser.run(f"[...document.querySelectorAll('label')].find(l => l.textContent === '{label}').click()")
            browser.run("view.show(4)")
            seen[label] = browser.run(PIXELS)
        for value in ("confidence", "distance to the scan", "cam00"):
            choose = (
                f"[...document.querySelectorAll('select')].forEach(s => {{ if ([...s.options].some(o => o.value === '{value}'))"
                f" {{ s.value = '{value}'; s.dispatchEvent(new Event('change')); }} }})"
            )
            browser.run(choose)
            browser.run("view.show(4)")
            seen[value] = browser.run(PIXELS)
        browser.run("view.show(2)")  # it failed: nothing is drawn, and that is no error
        seen["failed"] = browser.run(PIXELS)
        assert len(set(seen.values())) == len(seen), seen
        assert browser.errors == []


def test_two_runs_stand_side_by_side_at_the_same_frame(run, browser):
    with served(run, SAMPLE) as (host, port):
        browser.errors.clear()
        browser.open(f"http://{host}:{port}/", "globalThis.view?.clips.length === 2")
        browser.run("(() => { view.state.scan = true; return view.show(3); })()")
        halves = browser.run(
            "(() => { view.draw(); const gl = document.getElementById('scene').getContext('webgl2'), w = gl.drawingBufferWidth,"
            " h = gl.drawingBufferHeight, p = new Uint8Array(4 * w * h); gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, p);"
            " const n = [0, 0]; for (let i = 0; i < w * h; i++) if (Math.abs(p[4 * i] - p[0]) > 20) n[i % w < w / 2 ? 0 : 1]++;"
            " return n; })()"
        )
        assert min(halves) > 1000 and browser.errors == []


def test_an_animation_wears_its_textures(browser, tmp_path):
    clip = bending_clip()
    write_animation(clip, tmp_path)
    shown = Shown(tmp_path)
    data = shown.split("t-shirt")
    n, m = struct.unpack("<I", data[:4])[0], len(clip.layers[1].faces)
    vertex = np.frombuffer(data, "<u4", n, 4)
    uv = np.frombuffer(data, "<u2", 2 * n, 4 + 4 * n).reshape(-1, 2) / 65535
    faces = np.frombuffer(data, "<u4", 3 * m, 4 + 8 * n).reshape(-1, 3)
    assert np.array_equal(vertex[faces], clip.layers[1].faces)
    assert np.abs(uv[faces] - (clip.layers[1].uv[clip.layers[1].face_uv] * [1, -1] + [0, 1])).max() < 1e-4
    with served(tmp_path) as (host, port):
        browser.errors.clear()
        browser.open(f"http://{host}:{port}/", "globalThis.view?.state.colour === 'texture'")
        red = browser.run(
            "(() => { view.draw(); const gl = document.getElementById('scene').getContext('webgl2'), w = gl.drawingBufferWidth,"
            " h = gl.drawingBufferHeight, p = new Uint8Array(4 * w * h); gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, p);"
            " let n = 0; for (let i = 0; i < w * h; i++) n += p[4 * i] > 40 && p[4 * i + 1] * 5 < p[4 * i]; return n; })()"
        )
        assert red > 1000 and browser.errors == []


def test_a_slider_poses(browser, tmp_path):
    server = serve([Shown(tmp_path, Puppet())], 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    browser.errors.clear()
    browser.open(f"http://127.0.0.1:{server.server_address[1]}/", "globalThis.view")
    lowest = "view.clips[0].surfaces.get('inner').surface.low[2]"
    before = browser.run(lowest)
    browser.run(
        "(() => { const s = document.querySelector('input[aria-label=lift]'); s.value = 45;"
        " s.dispatchEvent(new Event('input')); return view.show(view.state.frame); })()"
    )
    assert browser.run(lowest) - before == pytest.approx(0.5, abs=1e-4) and browser.errors == []
    server.shutdown()
    server.server_close()


def test_frames_that_have_been_seen_are_ready_again_at_20_a_second(run, browser):
    """What the page does but for drawing: points, normals, buffers of 13.7k and 2k vertices."""
    with served(run) as (host, port):
        browser.open(f"http://{host}:{port}/", "globalThis.view")
        seconds = browser.run(
            "(async () => { const took = []; for (let i = 0; i < 40; i++) { const t = performance.now();"
            " await view.load(view.frames[i % view.frames.length]); took.push(performance.now() - t); }"
            " return took.slice(10).sort((a, b) => a - b)[3] / 1000; })()"
        )
        assert seconds < 0.05
