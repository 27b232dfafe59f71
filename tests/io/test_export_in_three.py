"""A GLB in three.js, in a real browser. npm's three must lie in a node_modules on NODE_PATH."""

import functools
import http.server
import os
import shutil
import threading
from pathlib import Path

import numpy as np
import pytest

from tests.support.bending_clip import bending_clip
from tests.support.browser import Browser
from toile.io.export.clip import TO_Y_UP
from toile.io.export.writing import MOTIONS, write_clip

PAGE = """<!doctype html><script type="importmap">{"imports": {"three": "./three/build/three.module.js"}}</script>
<link rel="icon" href="data:,"><script type="module">
import * as THREE from 'three';
import {GLTFLoader} from './three/examples/jsm/loaders/GLTFLoader.js';
const loaded = await new GLTFLoader().loadAsync('clip.glb'), mixer = new THREE.AnimationMixer(loaded.scene);
mixer.clipAction(loaded.animations[0]).play();
globalThis.at = (seconds, name) => {
  mixer.setTime(seconds);
  loaded.scene.updateMatrixWorld(true);
  const found = [];
  loaded.scene.traverse(thing => {
    if (!thing.isMesh || thing.name !== name) return;
    for (let i = 0; i < thing.userData.vertices; i++) found.push(thing.getVertexPosition(i, new THREE.Vector3()).toArray());
  });
  return found;
};
</script>"""


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.mark.parametrize("motion", MOTIONS)
def test_three_js_finds_every_vertex_where_it_was_registered(motion, tmp_path):
    three = next((p for p in os.environ.get("NODE_PATH", "").split(":") if p and (Path(p) / "three").is_dir()), None)
    if three is None or shutil.which("chromium") is None:
        pytest.skip("npm's three, or chromium, is not installed")
    clip = bending_clip(loose=0.003 if motion == "points" else 0.0)
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "three").symlink_to(Path(three) / "three")
    (tmp_path / "site" / "index.html").write_text(PAGE)
    write_clip(clip, tmp_path / "site" / "clip.glb", "glb", motion, lambda *_: None)
    handler = functools.partial(Quiet, directory=tmp_path / "site")
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with Browser(tmp_path / "profile") as browser:
        browser.open(f"http://127.0.0.1:{server.server_address[1]}/", "globalThis.at")
        for frame in clip.frames[:-1]:  # at its end a clip begins anew
            for layer in clip.layers:
                found = np.array(browser.run(f"at({(frame - clip.frames[0]) / clip.fps}, '{layer.name}')"))
                assert np.abs(found - layer.at(frame) @ TO_Y_UP["z"].T).max() < 2e-6
        assert browser.errors == []
    server.shutdown()
