// The page: what the server shows, over time. Data of a frame is asked for when it is wanted, and of the next ones ahead.

import {Lines, Picture, Surface, captured, looking, perspective, programs, pyramid} from './gl.js';

const $ = id => document.getElementById(id);
const make = (tag, fields = {}, ...inside) => { const e = Object.assign(document.createElement(tag), fields); e.append(...inside); return e; };
const COLOURS = [[0.80, 0.70, 0.62], [0.45, 0.58, 0.75], [0.62, 0.72, 0.50], [0.75, 0.60, 0.72]];
const MARKS = {doubtful: '#d99a2b', wrong: '#b3261e', failed: '#777'};
const AHEAD = 12, KEPT = 600;  // frames asked for ahead; answers kept

const clips = await (await fetch('facts')).json();
const frames = [...new Set(clips.flatMap(clip => [...clip.frames, ...Object.keys(clip.marks).map(Number)]))].sort((a, b) => a - b);
const canvas = $('scene'), gl = canvas.getContext('webgl2', {antialias: !drawnBySoftware()});
if (!gl) { $('said').textContent = 'this browser has no WebGL 2'; throw new Error('no WebGL 2'); }
const shaders = programs(gl);
const state = {frame: frames[0], playing: false, scan: false, cameras: false, camera: '', alpha: 1, colour: clips.some(clip => clip.layers.some(layer => layer.colours.includes('texture'))) ? 'texture' : 'plain',
               yaw: 0.5, pitch: 0.1, distance: 3.2, target: null, turns: {}};
document.title = `toile view: ${clips.map(clip => clip.name).join(', ')}`;

// Smooth edges cost a processor that stands in for a graphics card three times the time.
function drawnBySoftware() {
  const probe = document.createElement('canvas').getContext('webgl2'), info = probe?.getExtension('WEBGL_debug_renderer_info');
  const name = info ? probe.getParameter(info.UNMASKED_RENDERER_WEBGL) : '';
  probe?.getExtension('WEBGL_lose_context')?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

// answers ---------------------------------------------------------------------------------------------------------------
const answers = new Map();
function ask(path, kind = 'arrayBuffer') {
  if (!answers.has(path)) {
    answers.set(path, fetch(path).then(async r => r.ok ? r[kind]() : (say(await r.text()), null)));
    if (answers.size > KEPT) answers.delete(answers.keys().next().value);
  }
  return answers.get(path);
}
const say = text => { $('said').textContent = text; };
const place = (i, ...parts) => [i, ...parts].map(encodeURIComponent).join('/');

// what is drawn ----------------------------------------------------------------------------------------------------------
for (const [i, clip] of clips.entries()) {
  clip.surfaces = new Map();
  for (const [k, layer] of clip.layers.entries()) {
    const faces = new Uint32Array(await ask(place(i, 'faces', layer.name))), textured = layer.colours.includes('texture');
    const surface = new Surface(gl, faces, textured ? await ask(place(i, 'split', layer.name)) : null);
    if (textured) surface.texture.set(await createImageBitmap(await ask(place(i, 'texture', layer.name), 'blob')));
    clip.surfaces.set(layer.name, {surface, colour: COLOURS[k % COLOURS.length], layer, scaled: false, there: false});
  }
  clip.scanned = new Surface(gl, new Uint32Array());
  clip.picture = new Picture(gl);
  clip.rig = new Lines(gl, clip.cameras.flatMap(camera => pyramid(camera, 0.15)));
  clip.has = new Set(clip.frames);
}

// What the sliders turn, as the server reads it: "left arm up:30,head turned:-10".
const poseOf = () => Object.entries(state.turns).filter(([, angle]) => angle).map(([name, angle]) => `${name}:${angle}`).sort().join(',');

// Everything of a frame that is switched on, as promises by what they are for.
function wanted(i, frame) {
  const clip = clips[i], found = {};
  if (!clip.has.has(frame)) return found;
  for (const {name, colours, shown} of clip.layers) if (shown) {
    const pose = clip.turns.length ? poseOf() : '';
    found[`points ${name}`] = ask(pose ? place(i, 'posed', name, pose, frame) : place(i, 'points', name, frame));
    if (!['plain', 'texture'].includes(state.colour) && colours.includes(state.colour)) found[`colours ${name}`] = ask(place(i, 'colours', name, state.colour, frame));
  }
  if (state.scan && clip.scan) found.scan = ask(place(i, 'scan', frame));
  if (clip.cameras.some(camera => camera.name === state.camera)) found.picture = ask(place(i, 'picture', state.camera, frame), 'blob');
  return found;
}

async function load(frame) {
  for (const [i, clip] of clips.entries()) {
    const asked = wanted(i, frame), got = {};
    for (const name in asked) got[name] = await asked[name];
    for (const [name, part] of clip.surfaces) {
      part.there = Boolean(got[`points ${name}`]);
      if (part.there) part.surface.setPoints(got[`points ${name}`]);
      part.scaled = Boolean(got[`colours ${name}`]);
      if (part.scaled) part.surface.setShares(new Uint8Array(got[`colours ${name}`]));
    }
    clip.hasScan = Boolean(got.scan);
    if (got.scan) {
      const [n, m] = new Uint32Array(got.scan.slice(0, 8)), after = 8 + Math.ceil((24 + 6 * n) / 4) * 4;
      clip.scanned.setFaces(new Uint32Array(got.scan.slice(after, after + 12 * m)));
      clip.scanned.setPoints(got.scan, 8, n);
    }
    clip.hasPicture = Boolean(got.picture);
    if (got.picture) { const image = await createImageBitmap(got.picture); clip.picture.set(image); image.close(); }
  }
}

// Shows a frame; of several asked for while one is loading, the last.
let loading = null, next = null;
async function show(frame) {
  next = frame;
  loading ??= (async () => {
    while (next !== null) {
      const now = next;
      next = null;
      say('');
      await load(now);
      state.frame = now;
      aim();
      draw();
    }
    loading = null;
  })();
  await loading;
  const at = frames.indexOf(state.frame);
  for (let k = 1; k <= (turns.length ? 0 : AHEAD); k++) clips.forEach((_, i) => frames[at + k] !== undefined && wanted(i, frames[at + k]));
}

function aim() {
  if (state.target) return;
  const part = clips.flatMap(clip => [...clip.surfaces.values(), {surface: clip.scanned, there: clip.hasScan}]).find(p => p.there);
  if (part) state.target = part.surface.low.map((x, k) => x + part.surface.size[k] / 2);
}

function draw() {
  const scale = window.devicePixelRatio || 1, width = Math.round(canvas.clientWidth * scale), height = Math.round(canvas.clientHeight * scale);
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const dark = matchMedia('(prefers-color-scheme: dark)').matches;
  gl.enable(gl.DEPTH_TEST);
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  gl.viewport(0, 0, width, height);
  gl.clearColor(...(dark ? [0.09, 0.10, 0.12] : [0.97, 0.96, 0.95]), 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  clips.forEach((clip, i) => drawClip(clip, [Math.round(width * i / clips.length), 0, Math.round(width / clips.length), height]));
  drawTime();
}

function drawClip(clip, [x, y, w, h]) {
  const camera = clip.cameras.find(c => c.name === state.camera);
  let {view, projection} = camera ? captured(camera, 0.05, 100) : {view: looking(...eyeOf(clip)), projection: perspective(0.6, w / h, 0.02, 100)};
  if (camera) {  // the whole picture, its sides kept
    const share = Math.min(w / camera.width, h / camera.height), pw = camera.width * share, ph = camera.height * share;
    [x, y, w, h] = [x + (w - pw) / 2, y + (h - ph) / 2, pw, ph];
  }
  gl.viewport(x, y, w, h);
  if (camera && clip.hasPicture) clip.picture.draw(shaders);
  if (clip.hasScan && state.scan) clip.scanned.draw(shaders, view, projection, [0.6, 0.6, 0.6], false, false, state.alpha);
  for (const {surface, colour, layer, there, scaled} of clip.surfaces.values())
    if (there && layer.shown) surface.draw(shaders, view, projection, colour, scaled, state.colour === 'texture', state.alpha);
  if (state.cameras && !camera) clip.rig.draw(shaders, view, projection, [0.70, 0.33, 0.18]);
}

function eyeOf(clip) {
  const up = [0, 1, 2].map(k => 'xyz'[k] === clip.up ? 1 : 0), u = 'xyz'.indexOf(clip.up), a = (u + 1) % 3, b = (u + 2) % 3;
  const eye = [...(state.target ?? [0, 0, 0])];
  eye[a] += state.distance * Math.cos(state.pitch) * Math.sin(state.yaw);
  eye[b] -= state.distance * Math.cos(state.pitch) * Math.cos(state.yaw);
  eye[u] += state.distance * Math.sin(state.pitch);
  return [eye, state.target ?? [0, 0, 0], up];
}

// the time line -----------------------------------------------------------------------------------------------------------
function drawTime() {
  const line = $('line'), scale = window.devicePixelRatio || 1, w = line.clientWidth * scale, h = line.clientHeight * scale;
  line.width = w;
  line.height = h;
  const pen = line.getContext('2d'), style = getComputedStyle(document.documentElement), at = frame => atFrame(frame, w, scale);
  pen.fillStyle = style.getPropertyValue('--line');
  pen.fillRect(at(frames[0]), h - 6 * scale, at(frames.at(-1)) - at(frames[0]), 2 * scale);
  for (const [i, clip] of clips.entries()) {
    const values = clip.curve?.values.filter(v => v !== null) ?? [], top = Math.max(...values, 1e-9);
    pen.strokeStyle = style.getPropertyValue(i ? '--mark' : '--soft');
    pen.lineWidth = scale;
    pen.beginPath();
    clip.curve?.values.forEach((v, k) => v === null || pen.lineTo(at(clip.frames[k]), h - 8 * scale - v / top * (h - 12 * scale)));
    pen.stroke();
    for (const [frame, kind] of Object.entries(clip.marks)) {
      pen.fillStyle = MARKS[kind];
      pen.fillRect(at(Number(frame)) - 1.5 * scale, h - (kind === 'doubtful' ? 14 : 20) * scale, 3 * scale, (kind === 'doubtful' ? 14 : 20) * scale);
    }
  }
  pen.fillStyle = style.getPropertyValue('--ink');
  pen.fillRect(at(state.frame) - scale, 0, 2 * scale, h);
  const marks = clips.map(clip => clip.marks[state.frame]).filter(Boolean), k = clips[0].frames.indexOf(state.frame), v = clips[0].curve?.values[k];
  $('number').textContent = `frame ${state.frame}${marks.length ? `: ${marks.join(', ')}` : ''}`;
  $('number').title = v === undefined || v === null ? '' : `${clips[0].curve.name}: ${v.toFixed(2)}`;
}
const atFrame = (frame, w, scale) => 4 * scale + (w - 8 * scale) * (frame - frames[0]) / Math.max(frames.at(-1) - frames[0], 1);

function frameAt(event) {
  const box = $('line').getBoundingClientRect(), t = (event.clientX - box.left - 4) / (box.width - 8);
  const number = frames[0] + t * (frames.at(-1) - frames[0]);
  return frames.reduce((best, f) => Math.abs(f - number) < Math.abs(best - number) ? f : best);
}
$('line').addEventListener('pointerdown', event => { event.target.setPointerCapture(event.pointerId); show(frameAt(event)); });
$('line').addEventListener('pointermove', event => { if (event.buttons) show(frameAt(event)); });
const step = by => show(frames[Math.min(Math.max(frames.indexOf(state.frame) + by, 0), frames.length - 1)]);
function toMark(way) {
  const marked = frames.filter(f => clips.some(clip => clip.marks[f]) && (f - state.frame) * way > 0);
  if (marked.length) show(way > 0 ? marked[0] : marked.at(-1));
}

async function play() {
  state.playing = !state.playing;
  $('play').textContent = state.playing ? 'pause' : 'play';
  for (let began = performance.now(), first = frames.indexOf(state.frame); state.playing;) {
    const k = first + Math.floor((performance.now() - began) / 1000 * clips[0].rate);
    await show(frames[k % frames.length]);
    await new Promise(requestAnimationFrame);
  }
}
$('play').addEventListener('click', play);
addEventListener('keydown', event => {
  if (event.target.matches('select, input')) return;
  const keys = {ArrowRight: () => step(1), ArrowLeft: () => step(-1), n: () => toMark(1), p: () => toMark(-1), ' ': play};
  if (keys[event.key]) { event.preventDefault(); keys[event.key](); }
});

// the panel ---------------------------------------------------------------------------------------------------------------
const tick = (text, checked, change) => {
  const box = make('input', {type: 'checkbox', checked});
  box.addEventListener('change', () => { change(box.checked); show(state.frame); });
  return make('label', {}, box, text);
};
const choice = (options, change) => {
  const box = make('select', {}, ...options.map(([value, text]) => make('option', {value}, text)));
  box.addEventListener('change', () => { change(box.value); show(state.frame); });
  return box;
};
const panel = $('panel');
for (const clip of clips) {
  panel.append(make('h2', {}, clip.name));
  for (const layer of clip.layers) panel.append(tick(layer.name, layer.shown, on => { layer.shown = on; }));
}
if (clips.some(clip => clip.scan)) panel.append(make('h2', {}, 'capture'), tick('scan', false, on => { state.scan = on; }));
const cameras = [...new Set(clips.flatMap(clip => clip.cameras.map(camera => camera.name)))];
if (cameras.length) {
  const names = [['', 'from anywhere'], ...cameras.map(name => [name, `through ${name}`])];
  panel.append(tick('cameras', false, on => { state.cameras = on; }), choice(names, name => { state.camera = name; }));
}
const kinds = [...new Set(clips.flatMap(clip => clip.layers.flatMap(layer => layer.colours)))];
if (kinds.length > 1) {
  const legend = make('div', {hidden: true}, make('div', {className: 'bar'}), make('div', {className: 'soft'}));
  panel.append(make('h2', {}, 'colours'), choice(kinds.map(kind => [kind, kind]), kind => {
    state.colour = kind;
    legend.hidden = ['plain', 'texture'].includes(kind);
    legend.lastChild.textContent = kind === 'confidence' ? 'observed, interpolated, hidden' : '0 to 20 mm and more';
  }), legend);
}
const turns = [...new Set(clips.flatMap(clip => clip.turns))];
if (turns.length) panel.append(make('h2', {}, 'pose'));
for (const name of turns) {
  const slider = make('input', {type: 'range', min: -90, max: 90, step: 5, value: 0, ariaLabel: name});
  slider.addEventListener('input', () => { state.turns[name] = Number(slider.value); show(state.frame); });
  panel.append(make('label', {className: 'soft'}, name), slider);
}
const alpha = make('input', {type: 'range', min: 0.1, max: 1, step: 0.05, value: 1, ariaLabel: 'opacity'});
alpha.addEventListener('input', () => { state.alpha = Number(alpha.value); draw(); });
panel.append(make('h2', {}, 'opacity'), alpha,
  make('p', {className: 'soft'}, 'Drag turns, wheel goes near, right button shifts. Arrows step, space plays, n and p go to marked frames: amber doubtful, red wrong, grey failed.'));

// the mouse ---------------------------------------------------------------------------------------------------------------
canvas.addEventListener('contextmenu', event => event.preventDefault());
canvas.addEventListener('pointerdown', event => canvas.setPointerCapture(event.pointerId));
canvas.addEventListener('pointermove', event => {
  if (!event.buttons || state.camera) return;
  if (event.buttons === 1) {
    state.yaw -= event.movementX / 150;
    state.pitch = Math.min(Math.max(state.pitch + event.movementY / 150, -1.5), 1.5);
  } else if (state.target) {
    const m = looking(...eyeOf(clips[0])), far = state.distance / canvas.clientHeight * 0.62;
    state.target = state.target.map((x, k) => x - far * (event.movementX * m[4 * k] - event.movementY * m[4 * k + 1]));
  }
  draw();
});
canvas.addEventListener('wheel', event => { event.preventDefault(); state.distance *= Math.exp(event.deltaY / 800); draw(); }, {passive: false});
addEventListener('resize', draw);

await show(frames[0]);
globalThis.view = {show, load, draw, state, frames, clips};  // for the browser's console
