// What is wrong and what to do, the frames over time, the frame in hand, and the pictures of the worst.
const STATE_NAMES = ['good', 'doubtful', 'wrong', 'failed', 'pending'];

// Ascending numbers as ranges, [1, 2, 3, 7] -> "1-3,7".
function ranges(numbers, between = ',', most = Infinity) {
  const runs = [];
  for (const n of [...numbers].sort((a, b) => a - b)) runs.length && n === runs.at(-1)[1] + 1 ? runs.at(-1)[1] = n : runs.push([n, n]);
  const shown = runs.slice(0, most).map(([a, b]) => a === b ? `${a}` : `${a}-${b}`).join(between);
  return runs.length > most ? `${shown}${between}\u2026` : shown;
}

// by verdict --------------------------------------------------------------------------------------------------------------
const kinds = [
  {name: 'all frames', test: () => true, className: ''},
  ...[[3, 'failed'], [2, 'wrong'], [1, 'doubtful']].map(([s, name]) => ({name, test: i => data.state[i] === s, className: name})),
  {name: 'good, but odd', test: unlike, className: 'doubtful'},
  {name: 'good', test: i => data.state[i] === 0 && !unlike(i), className: 'good'},
  {name: 'not finished', test: i => data.state[i] === 4, className: 'pending'},
].map(kind => ({...kind, count: data.frames.filter((_, i) => kind.test(i)).length})).filter((kind, k) => k === 0 || kind.count || kind.name === 'good');
for (const kind of kinds) {
  kind.button = make('button', {className: kind.className}, make('b', {}, kind.count.toLocaleString('en')), kind.name);
  kind.button.addEventListener('click', () => { states = kind === kinds[0] ? null : kind; only = null; scroll.scrollTop = 0; refresh(); if (view.length) go(view[0]); });
  $('states').append(kind.button);
}
const drawChips = () => { for (const kind of kinds) kind.button.setAttribute('aria-pressed', states ? kind === states : kind === kinds[0] && !only); };

// what is wrong -------------------------------------------------------------------------------------------------------------
const SHOWN = 6;  // kinds of trouble before "more"
data.troubles.forEach((trouble, k) => {
  const numbers = trouble.rows.map(i => data.frames[i]), name = STATE_NAMES[trouble.state || 1];
  const show = make('button', {}, 'show'), select = make('button', {}, 'select');
  show.addEventListener('click', () => { only = {title: trouble.title, rows: new Set(trouble.rows)}; states = null; scroll.scrollTop = 0; refresh(); go(view[0]); $('frames').scrollIntoView(); });
  select.addEventListener('click', () => { trouble.rows.forEach(i => picked.add(i)); drawRows(); drawPicked(); $('again').scrollIntoView({block: 'nearest'}); });
  const line = make('div', {className: `trouble ${name}`, hidden: k >= SHOWN}, make('b', {className: 'count'}, ...trouble.counts.map(([s, n]) => make('span', {className: STATE_NAMES[s || 1]}, `${n.toLocaleString('en')} ${s ? data.states[s] : 'good, but odd'}`))),
    make('div', {}, make('b', {}, trouble.title), make('span', {className: 'at'}, `${numbers.length > 1 ? 'frames' : 'frame'} ${ranges(numbers, ', ', 6)}`)), make('div', {className: 'do'}, trouble.do), make('div', {className: 'buttons'}, show, select));
  $('troubles').append(line);
});
if (!data.troubles.length) $('troubles').append(make('p', {className: 'good'}, 'Nothing: every frame is good, and none is unlike the rest.'));
if (data.troubles.length > SHOWN) {
  const more = make('button', {}, `${data.troubles.length - SHOWN} more kinds`);
  more.addEventListener('click', () => { document.querySelectorAll('.trouble').forEach(e => { e.hidden = false; }); more.remove(); });
  $('troubles').append(more);
}

// over time -----------------------------------------------------------------------------------------------------------------
data.columns.forEach((c, k) => $('measure').append(make('option', {value: k}, `${c.group}: ${c.words}${c.unit ? ` [${c.unit}]` : ''}`)));
$('measure').value = Math.max(data.columns.findIndex(c => c.level.includes('2')), data.columns.findIndex(c => c.level.includes('1')), 0);
$('measure').addEventListener('change', () => drawLine());
const low = Math.min(...data.frames.slice(0, 1), data.frames.at(-1)), span = Math.max(data.frames.at(-1) - low, 1);
const stride = data.frames.reduce((least, f, i) => i ? Math.min(least, f - data.frames[i - 1]) : least, Infinity);  // between neighbours

function drawLine() {
  const canvas = $('line'), scale = devicePixelRatio || 1, w = canvas.clientWidth * scale, h = canvas.clientHeight * scale;
  if (!w) return;
  Object.assign(canvas, {width: w, height: h});
  const pen = canvas.getContext('2d'), style = getComputedStyle(document.documentElement), colour = name => style.getPropertyValue(`--${name}`);
  const strip = 14 * scale, bottom = h - strip - 6 * scale, x = i => (8 + (canvas.clientWidth - 16) * (data.frames[i] - low) / span) * scale, wide = Math.max((w - 16 * scale) / (span + 1), 1.5 * scale);
  const inView = new Set(view);
  for (const s of [0, 4, 1, 2, 3]) for (let i = 0; i < data.frames.length; i++) if (data.state[i] === s) {  // the grave over the good
    pen.globalAlpha = (s ? 1 : 0.35) * (inView.has(i) ? 1 : 0.35);
    pen.fillStyle = colour(STATE_NAMES[s]);
    pen.fillRect(x(i) - wide / 2, h - strip, wide, strip);
  }
  pen.globalAlpha = 1;
  const c = data.columns[$('measure').value];
  if (c) {
    const values = c.values.filter(v => v !== null), least = c.bad === 'low' ? values.reduce((a, b) => Math.min(a, b), Infinity) : 0, top = values.reduce((a, b) => Math.max(a, b), -Infinity), room = Math.max(top - least, 1e-9);
    const y = v => bottom - (v - least) / room * (bottom - 8 * scale);
    pen.lineWidth = scale;
    for (const [value, name] of [[c.edge, 'doubtful'], [c.limits?.[0], 'doubtful'], [c.limits?.[1], 'wrong']]) if (value !== null && value !== undefined && value >= least && value <= top) {
      pen.strokeStyle = colour(name);
      pen.setLineDash([4 * scale, 4 * scale]);
      pen.beginPath();
      pen.moveTo(0, y(value));
      pen.lineTo(w, y(value));
      pen.stroke();
    }
    pen.setLineDash([]);
    pen.strokeStyle = colour('ink');
    pen.beginPath();
    c.values.forEach((v, i) => { if (v !== null) (i && c.values[i - 1] !== null && data.frames[i] - data.frames[i - 1] <= stride ? pen.lineTo(x(i), y(v)) : (pen.moveTo(x(i) - scale, y(v)), pen.lineTo(x(i), y(v)))); });
    pen.stroke();
    c.values.forEach((v, i) => { if (v !== null && c.level[i] !== '0') { pen.fillStyle = colour(c.level[i] === '2' ? 'wrong' : 'doubtful'); pen.fillRect(x(i) - 2 * scale, y(v) - 2 * scale, 4 * scale, 4 * scale); } });
    pen.fillStyle = colour('soft');
    pen.font = `${11 * scale}px system-ui, sans-serif`;
    pen.fillText(`${text(top)} ${c.unit}`, 6 * scale, 12 * scale);
    $('line-words').textContent = `${sentence(c.meaning)}. ${limitsOf(c)}.${here.row === null ? '' : ` Frame ${data.frames[here.row]}: ${full(c.values[here.row], c.unit)}.`}`;
  }
  if (here.row !== null) { pen.fillStyle = colour('focus'); pen.fillRect(x(here.row) - scale, 0, 2 * scale, h); }
}
$('line').addEventListener('click', event => {
  const box = $('line').getBoundingClientRect(), number = low + (event.clientX - box.left - 8) / (box.width - 16) * span;
  const near = data.frames.reduce((best, f, i) => Math.abs(f - number) < Math.abs(data.frames[best] - number) ? i : best, 0);
  if (!view.includes(near)) { filters.clear(); states = only = null; head.dataset.key = ''; refresh(); }
  go(near, true);
});
addEventListener('resize', () => { drawLine(); drawHead(); drawRows(); });
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => drawLine());

// the frame in hand ---------------------------------------------------------------------------------------------------------
const picturesOf = new Map(data.pictures.map(p => [p.row, p.shown]));
function picture([caption, id]) {
  const image = make('img', {alt: caption});
  image.dataset.from = id;
  seen.observe(image);
  const large = make('button', {className: 'large', title: 'larger, smaller'}, image);
  large.addEventListener('click', () => large.setAttribute('aria-pressed', large.getAttribute('aria-pressed') !== 'true'));
  return make('figure', {}, large, make('figcaption', {}, caption));
}
const whole = document.readyState === 'loading' ? new Promise(done => addEventListener('DOMContentLoaded', done)) : Promise.resolve();
const seen = new IntersectionObserver(entries => entries.filter(e => e.isIntersecting).forEach(async ({target}) => {  // decoded when it comes near
  seen.unobserve(target);
  await whole;  // pictures stand behind the script, so that the table is there before them
  target.src = `data:image/jpeg;base64,${$(target.dataset.from).textContent}`;
}), {rootMargin: '300px'});

const SAID = 4;  // reasons that are spelt out
function drawDetail(i) {
  const shown = picturesOf.get(i), said = data.reasons[i];
  const values = make('table', {className: 'values'}, ...data.columns.filter(c => c.values[i] !== null).map(c =>
    make('tr', {title: c.meaning}, make('td', {}, `${c.group}: ${c.words}`), make('td', {className: `l${c.level[i]}`}, `${text(c.values[i])} ${c.unit}`), make('td', {className: 'soft'}, c.middle === null ? '' : `median ${text(c.middle)}`))));
  const advice = data.troubles.find(t => t.rows.includes(i))?.do;
  $('detail').replaceChildren(make('h3', {}, `Frame ${data.frames[i]}: `, markOf(i)),
    ...(said.length ? [make('ul', {}, ...said.slice(0, SAID).map(reason => make('li', {}, reason)), ...(said.length > SAID ? [make('li', {className: 'soft', title: said.slice(SAID).join('; ')}, `and ${said.length - SAID} more`)] : []))] : []), ...(advice ? [make('p', {className: 'soft'}, advice)] : []),
    shown ? make('div', {className: 'pictures'}, ...shown.map(picture)) : make('p', {className: 'soft'}, `Pictures are made of the worst ${data.pictures.length}. See this frame by: toile view ${data.path}`),
    make('details', {open: !shown}, make('summary', {}, 'all its measures'), values));
}

// giving again --------------------------------------------------------------------------------------------------------------
function commandFor(rows) {
  return data.command && rows.length ? `${data.command} --retry ${ranges(rows.map(i => data.frames[i]))}` : '';
}
function drawPicked() {
  const rows = [...picked], command = commandFor(rows), numbers = rows.map(i => data.frames[i]);
  $('selected').textContent = rows.length ? `${rows.length} selected: ${ranges(numbers, ', ', 12)}` : 'Select frames by their boxes, space or shift, to get the command that gives them again.';
  $('command').hidden = !rows.length;
  $('command').textContent = command || `--frames ${ranges(numbers)}`;
}
async function copy(value) {
  try { await navigator.clipboard.writeText(value); } catch { const range = document.createRange(); range.selectNodeContents($('command')); getSelection().removeAllRanges(); getSelection().addRange(range); document.execCommand('copy'); }
}
const action = (name, does) => { const b = make('button', {}, name); b.addEventListener('click', does); $('again-buttons').append(b); return b; };
action('copy the command', async event => { await copy($('command').textContent); event.target.textContent = 'copied'; setTimeout(() => { event.target.textContent = 'copy the command'; }, 1500); });
action('select all in the table', () => { view.forEach(i => picked.add(i)); drawRows(); drawPicked(); });
action('select none', () => { picked.clear(); drawRows(); drawPicked(); });

// the worst -----------------------------------------------------------------------------------------------------------------
for (const {row, shown} of data.pictures) {
  const name = make('button', {}, 'in the table');
  name.addEventListener('click', () => { filters.clear(); states = only = null; head.dataset.key = ''; refresh(); go(row, true); $('frames').scrollIntoView(); });
  $('worst').append(make('div', {className: `bad ${classOf(row)}`}, make('h3', {}, `Frame ${data.frames[row]}: `, markOf(row), ' ', name),
    make('p', {}, why(row) || 'nothing is out of line'), make('div', {className: 'pictures'}, ...shown.map(picture))));
}

drawPicked();
refresh();
if (view.length) go(view[0]);
performance.mark('table');
globalThis.triage = {data, refresh, sort, go, picked, filters, commandFor, view: () => view};  // for the browser's console
