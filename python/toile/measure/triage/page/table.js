// The table: all rows in `view`, of which only those within sight are elements.
const HEIGHT = 28, WIDE = 85, BEYOND = 8;  // px of a row and of a column; rows drawn above and below those in sight
const scroll = $('scroll'), table = $('table'), head = table.tHead, body = table.tBodies[0];
const filters = new Map();  // column, or 'why': the text
let view = [], sorted = null, states = null, only = null, anchor = null;
const here = {row: null}, picked = new Set();
const groups = [...new Set(data.columns.map(c => c.group))], anyOut = group => data.columns.some(c => c.group === group && /[12]/.test(c.level));
const hiddenGroups = new Set(['Seconds', ...anyOut('Pose and pictures') ? [] : ['Pose and pictures']].filter(g => groups.length > 3 && groups.includes(g)));
const visible = () => data.columns.filter(c => !hiddenGroups.has(c.group));

const text = value => value === null ? '\u2013' : Math.abs(value) >= 100 ? value.toFixed(0) : Math.abs(value) >= 10 ? value.toFixed(1) : value.toFixed(Number.isInteger(value) ? 0 : 2);
const why = i => data.reasons[i].length ? data.reasons[i].join('; ') : '';
const stateOf = i => data.states[data.state[i]];
const unlike = i => data.state[i] === 0 && data.reasons[i].length > 0;
const classOf = i => unlike(i) ? 'doubtful' : ['good', 'doubtful', 'wrong', 'failed', 'pending'][data.state[i]];
const markOf = i => make('b', {className: classOf(i)}, unlike(i) ? 'good, but odd' : stateOf(i));

// Does a value pass "> 5", "< 3", "2..7", "2-7", "out", "none" or "= 4"? Null where the text says nothing yet.
function passes(given, column) {
  const t = given.trim().toLowerCase();
  if (!t) return null;
  if (t === 'out') return i => column.level[i] !== '0';
  if (t === 'none' || t === '-') return i => column.values[i] === null;
  const one = t.match(/^(>=|<=|>|<|=)?\s*(-?\d*\.?\d+)$/), two = t.match(/^(-?\d*\.?\d+)\s*(?:\.\.|-)\s*(-?\d*\.?\d+)$/);
  if (two) return i => column.values[i] !== null && column.values[i] >= +two[1] && column.values[i] <= +two[2];
  if (!one) return null;
  const n = +one[2], tests = {'>': v => v > n, '<': v => v < n, '>=': v => v >= n, '<=': v => v <= n, '=': v => v === n};
  const test = tests[one[1] ?? '>='];
  return i => column.values[i] !== null && test(column.values[i]);
}

const frameColumn = {words: 'frame', values: data.frames, level: ''};
function refresh() {
  const tests = [];
  for (const [column, given] of filters) {
    if (column === 'why') { const wanted = given.trim().toLowerCase(); if (wanted) tests.push(i => `${stateOf(i)} ${why(i)}`.toLowerCase().includes(wanted)); continue; }
    const ranges = column === frameColumn && given.trim() ? given.split(',').map(part => passes(/^\s*\d+\s*$/.test(part) ? `=${part}` : part, column)).filter(Boolean) : null;
    const test = ranges?.length ? i => ranges.some(r => r(i)) : ranges ? null : passes(given, column);
    if (test) tests.push(test);
  }
  if (states) tests.push(states.test);
  if (only) tests.push(i => only.rows.has(i));
  view = data.order.filter(i => tests.every(test => test(i)));
  if (sorted) {
    const {column, down} = sorted, v = column.values, sign = down ? -1 : 1;
    const rank = new Map(view.map((i, k) => [i, k]));
    view.sort((a, b) => (v[a] === null) - (v[b] === null) || sign * (v[a] - v[b]) || rank.get(a) - rank.get(b));
  }
  $('count').textContent = `${view.length} of ${data.frames.length}${only ? `: ${only.title}` : ''}${sorted ? `, by ${sorted.column.words}` : ', worst first'}`;
  table.setAttribute('aria-rowcount', view.length);
  drawHead();
  drawRows();
  drawRows();  // the first made the table as high as it is
  drawChips();
  drawLine();
}

function drawHead() {
  const columns = visible(), all = [frameColumn, ...columns];
  const key = columns.map(c => c.group + c.words).join() + (sorted ? sorted.column.words + sorted.down : '') + scroll.clientWidth;
  if (head.dataset.key !== key) {
    head.dataset.key = key;
    const title = (column, extra) => {
      const arrow = sorted?.column === column ? (sorted.down ? ' \u25be' : ' \u25b4') : '';
      const button = make('button', {title: column.meaning ? `${column.group}: ${column.meaning}. ${limitsOf(column)}` : 'sort'}, column.words + arrow, ...(column.unit ? [make('small', {}, column.unit)] : []));
      button.addEventListener('click', () => sort(column));
      const cell = make('th', {scope: 'col', ...extra}, button);
      cell.setAttribute('aria-sort', sorted?.column === column ? (sorted.down ? 'descending' : 'ascending') : 'none');
      return cell;
    };
    const every = make('input', {type: 'checkbox', title: 'select all frames in the table', ariaLabel: 'select all frames in the table'});
    every.addEventListener('change', () => { view.forEach(i => every.checked ? picked.add(i) : picked.delete(i)); drawRows(); drawPicked(); });
    const box = (column, hint, label) => {
      const input = make('input', {value: filters.get(column) ?? '', placeholder: hint, ariaLabel: `filter: ${label}`, spellcheck: false});
      input.addEventListener('input', () => { filters.set(column, input.value); scroll.scrollTop = 0; refresh(); });
      return input;
    };
    const room = scroll.clientWidth - 34 - 70 - WIDE * columns.length, widths = [34, 70, Math.max(240, room), ...columns.map(() => WIDE)];
    table.querySelector('colgroup')?.remove();
    table.prepend(make('colgroup', {}, ...widths.map(w => { const c = make('col'); c.style.width = `${w}px`; return c; })));
    table.style.width = `${widths.reduce((a, b) => a + b)}px`;
    const stuck = (cell, left) => { cell.classList.add('first'); cell.style.left = `${left}px`; return cell; };
    head.replaceChildren(
      make('tr', {}, stuck(make('th', {}, every), 0), stuck(title(frameColumn, {}), 34), make('th', {className: 'why', style: 'text-align:left'}, make('small', {}, 'verdict and why')), ...columns.map(c => title(c, {}))),
      make('tr', {}, stuck(make('th'), 0), stuck(make('th', {}, box(frameColumn, '1-50,60', 'frame numbers')), 34), make('th', {}, box('why', 'words', 'verdict and reasons')), ...columns.map(c => make('th', {}, box(c, c.bad === 'low' ? '< 5, out' : '> 5, out', `${c.group}: ${c.words}`)))));
    table.style.setProperty('--head', `${head.rows[0].getBoundingClientRect().height}px`);
  }
}

const full = (value, unit) => `${text(value)}${unit ? ` ${unit}` : ''}`;
const sentence = words => words[0].toUpperCase() + words.slice(1);
const limitsOf = c => [`Median ${full(c.middle, c.unit)}`, c.edge === null || c.own ? '' : `unlike the rest from ${full(c.edge, c.unit)}`,
  c.limits ? `${c.own ? 'odd' : 'doubtful'} from ${full(c.limits[0], c.unit)}, ${c.own ? 'very odd' : 'wrong'} from ${full(c.limits[1], c.unit)}` : ''].filter(Boolean).join(', ');

// First the bad end, then the other, then worst first again.
function sort(column) {
  const first = column !== frameColumn && column.bad !== 'low';
  sorted = sorted?.column !== column ? {column, down: first} : sorted.down === first ? {column, down: !first} : null;
  scroll.scrollTop = 0;
  if (column.group) { $('measure').value = data.columns.indexOf(column); }
  refresh();
}

function drawRows() {
  const top = Math.max(Math.floor(scroll.scrollTop / HEIGHT) - BEYOND, 0), end = Math.min(top + Math.ceil(scroll.clientHeight / HEIGHT) + 2 * BEYOND, view.length);
  const columns = visible(), rows = [];
  const gap = n => { const row = make('tr', {ariaHidden: 'true'}); row.style.height = `${n * HEIGHT}px`; return row; };
  if (top) rows.push(gap(top));
  for (let k = top; k < end; k++) rows.push(drawRow(view[k], k, columns));
  if (end < view.length) rows.push(gap(view.length - end));
  body.replaceChildren(...rows);
}

function drawRow(i, k, columns) {
  const row = make('tr', {className: `${i === here.row ? 'here ' : ''}${picked.has(i) ? 'picked' : ''}`});
  row.setAttribute('aria-rowindex', k + 1);
  row.dataset.row = i;
  const box = make('input', {type: 'checkbox', checked: picked.has(i), tabIndex: -1, ariaLabel: `select frame ${data.frames[i]}`});
  const first = make('td', {className: 'first'}, box), number = make('td', {className: 'first'}, String(data.frames[i]));
  number.style.left = '34px';
  first.style.left = '0';
  row.append(first, number, make('td', {className: 'why', title: why(i)}, markOf(i), why(i) ? `: ${why(i)}` : ''));
  for (const c of columns) row.append(make('td', {className: `l${c.level[i]}`, title: c.level[i] === '0' ? '' : `${c.words}: ${limitsOf(c)}`}, text(c.values[i])));
  return row;
}

function pick(i, on) { on ? picked.add(i) : picked.delete(i); }
body.addEventListener('click', event => {
  const row = event.target.closest('tr[data-row]');
  if (!row) return;
  const i = +row.dataset.row;
  if (event.target.matches('input')) {
    const on = event.target.checked, from = event.shiftKey && anchor !== null ? view.indexOf(anchor) : -1, to = view.indexOf(i);
    if (from >= 0) view.slice(Math.min(from, to), Math.max(from, to) + 1).forEach(j => pick(j, on));
    else pick(i, on);
    anchor = i;
    drawPicked();
  }
  go(i);
});
scroll.addEventListener('scroll', () => requestAnimationFrame(drawRows), {passive: true});
scroll.addEventListener('keydown', event => {
  if (event.target.matches('input:not([type=checkbox])')) return;
  const at = view.indexOf(here.row), to = {ArrowDown: at + 1, ArrowUp: Math.max(at - 1, 0), Home: 0, End: view.length - 1, PageDown: at + 15, PageUp: at - 15}[event.key];
  if (to !== undefined && view.length) {
    const next = view[Math.min(Math.max(to, 0), view.length - 1)];
    if (event.shiftKey) { if (here.row !== null) pick(here.row, true); pick(next, true); drawPicked(); }
    go(next, true);
  } else if (event.key === ' ' && here.row !== null && event.target === scroll) { pick(here.row, !picked.has(here.row)); drawPicked(); drawRows(); }
  else if (event.key === 'Enter' && event.target === scroll) $('detail').scrollIntoView({block: 'nearest'});
  else if (event.key === 'Escape') { picked.clear(); drawPicked(); drawRows(); }
  else if (event.key === 'a' && (event.ctrlKey || event.metaKey)) { view.forEach(i => picked.add(i)); drawPicked(); drawRows(); }
  else return;
  event.preventDefault();
});

// Shows a frame: its row, its pictures, its place in time.
function go(i, into = false) {
  here.row = i;
  const at = view.indexOf(i), room = scroll.clientHeight - head.getBoundingClientRect().height;
  if (into && at >= 0 && (at * HEIGHT < scroll.scrollTop || (at + 1) * HEIGHT > scroll.scrollTop + room)) scroll.scrollTop = Math.max(at * HEIGHT - room / 2, 0);
  drawRows();
  drawDetail(i);
  drawLine();
}

for (const group of groups) {
  const box = make('input', {type: 'checkbox', checked: !hiddenGroups.has(group)});
  box.addEventListener('change', () => { box.checked ? hiddenGroups.delete(group) : hiddenGroups.add(group); refresh(); });
  $('groups').append(make('label', {}, box, ` ${group}`));
}
$('clear').addEventListener('click', () => { filters.clear(); states = only = sorted = null; head.dataset.key = ''; refresh(); });
