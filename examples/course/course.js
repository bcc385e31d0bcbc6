'use strict';
// course.js - draws what the module computes, and passes the controls to it. No number on the page is computed here: every one is an element
// of out[] of course.c, and its text is written by show(). With #numbers in the address the page checks itself, see the end.

const $ = (id) => document.getElementById(id);
const still = matchMedia('(prefers-reduced-motion: reduce)');
let C = null;                  // the module's functions
let IN, OUT, FIELD;            // its arrays
const chapters = {};           // name -> {call, inputs, draw, ...}
const record = location.hash === '#numbers' ? [] : null;

function call(name, inputs = []) {
  IN.fill(0), IN.set(inputs);
  if (record) FIELD.fill(0);
  const n = C[name]();
  if (record) {
    record.push(`call ${name} ${inputs.join(' ')}`, `out ${[...OUT.subarray(0, n)].join(' ')}`);
    const picks = [];
    for (let i = 0; i < FIELD.length; i += 149) picks.push(FIELD[i]);
    record.push(`field 149 ${picks.join(' ')}`);
  }
  return n;
}

// ------------------------------------------------------------------ text of numbers

function text(value, digits) {
  if (!isFinite(value)) return value > 0 ? '∞' : value < 0 ? '−∞' : 'not a number';
  const kind = digits[0] === 'e' ? value.toExponential(+digits.slice(1)) : value.toFixed(+digits);
  return kind.replace(/-/g, '−').replace('e+', 'e');
}

// <output data-at=i data-digits=d data-unit=u> inside `root` shows out[i].
function show(root) {
  for (const o of root.querySelectorAll('output[data-at]')) {
    const value = OUT[o.dataset.at], t = text(value, o.dataset.digits || '3');
    o.ariaLive = 'off'; // a screen reader would read every change of every number
    o.textContent = t + (o.dataset.unit ? '\u202f' + o.dataset.unit : '');
    if (record) record.push(`shown ${o.dataset.at} ${o.dataset.digits || '3'} ${t}`);
  }
}

const output = (at, digits, unit = '') => `<output data-at=${at} data-digits=${digits}${unit ? ` data-unit="${unit}"` : ''}></output>`;

// ------------------------------------------------------------------ controls

// value() of each control of a section: sliders by data-name; data-log: the value is 10^slider.
function slider(section, name) {
  const e = section.querySelector(`input[name=${name}]`);
  return e.dataset.log !== undefined ? 10 ** e.valueAsNumber : e.valueAsNumber;
}
function picked(section, name) { return +section.querySelector(`input[name=${name}]:checked`).value; }

function labelSliders(section) {
  for (const e of section.querySelectorAll('label.slide input')) {
    const value = e.dataset.log !== undefined ? 10 ** e.valueAsNumber : e.valueAsNumber;
    const t = e.dataset.log !== undefined ? (value < 1 ? value.toPrecision(2) : value < 100 ? value.toPrecision(3) : String(Math.round(value)))
      : String(e.value);
    e.parentNode.querySelector('b').textContent = t.replace('-', '−') + (e.dataset.unit ? '\u202f' + e.dataset.unit : '');
  }
}

function update(name) {
  const c = chapters[name];
  labelSliders(c.section);
  c.update();
}

// ------------------------------------------------------------------ drawing

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
let ink = {};
function readColours() {
  for (const k of ['bg', 'panel', 'ink', 'soft', 'line', 'accent', 'c1', 'c2', 'c3', 'c4', 'warn', 'field']) ink[k] = css('--' + k);
}

// The canvas `id` in CSS pixels: {g, w, h}. data-ratio is width / height; data-narrow the ratio below 480 px.
function pen(id) {
  const e = $(id), w = e.clientWidth || 300;
  const ratio = w < 480 && e.dataset.narrow ? +e.dataset.narrow : +e.dataset.ratio, h = Math.round(w / ratio);
  const d = Math.min(2, devicePixelRatio || 1);
  if (e.width !== Math.round(w * d) || e.height !== Math.round(h * d)) e.width = Math.round(w * d), e.height = Math.round(h * d), e.style.height = h + 'px';
  const g = e.getContext('2d');
  g.setTransform(d, 0, 0, d, 0, 0);
  g.clearRect(0, 0, w, h);
  g.font = '12.5px ' + css('--sans');
  g.lineJoin = 'round';
  return {g, w, h, e};
}

const scratch = document.createElement('canvas');
// Pixels w x h, colour(i) -> [r, g, b] of 0..1, as squares over the box.
function pixels(g, w, h, box, colour) {
  scratch.width = w, scratch.height = h;
  const s = scratch.getContext('2d'), image = s.createImageData(w, h);
  for (let i = 0; i < w * h; i++) {
    const c = colour(i);
    for (let k = 0; k < 3; k++) image.data[4 * i + k] = 255 * Math.min(1, Math.max(0, c[k]));
    image.data[4 * i + 3] = 255;
  }
  s.putImageData(image, 0, 0);
  g.imageSmoothingEnabled = false;
  g.drawImage(scratch, ...box);
}
const fieldRgb = (from) => (i) => [FIELD[from + 3 * i], FIELD[from + 3 * i + 1], FIELD[from + 3 * i + 2]];
const css3 = (c) => `rgb(${[0, 1, 2].map((k) => Math.round(255 * Math.min(1, Math.max(0, c[k]))))})`;
const parse = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);

function line(g, points, colour, width = 1.5, dash = []) {
  g.beginPath();
  let down = false;
  for (const [x, y] of points) {
    if (!isFinite(y)) { down = false; continue; }
    down ? g.lineTo(x, y) : g.moveTo(x, y);
    down = true;
  }
  g.strokeStyle = colour, g.lineWidth = width, g.setLineDash(dash), g.stroke(), g.setLineDash([]);
}
function label(g, t, x, y, colour, align = 'left', halo = false) {
  g.textAlign = align, g.textBaseline = 'middle';
  if (halo) g.strokeStyle = ink.field, g.lineWidth = 3, g.strokeText(t, x, y);
  g.fillStyle = colour, g.fillText(t, x, y);
}
function arrow(g, x, y, dx, dy, colour, width = 2) {
  const l = Math.hypot(dx, dy);
  if (l < 1) return;
  const a = Math.atan2(dy, dx), n = Math.min(8, 3 + l / 4);
  line(g, [[x, y], [x + dx, y + dy]], colour, width);
  line(g, [[x + dx - n * Math.cos(a - 0.5), y + dy - n * Math.sin(a - 0.5)], [x + dx, y + dy], [x + dx - n * Math.cos(a + 0.5), y + dy - n * Math.sin(a + 0.5)]],
    colour, width);
}
// k standard deviations of the covariance xx, xy, yy (px) around x, y; `zoom` screen px per px.
function ellipse(g, x, y, xx, xy, yy, k, zoom, colour, width = 1.5, dash = []) {
  const mean = (xx + yy) / 2, root = Math.hypot((xx - yy) / 2, xy), angle = Math.atan2(2 * xy, xx - yy) / 2;
  g.beginPath();
  g.ellipse(x, y, k * zoom * Math.sqrt(Math.max(0, mean + root)), k * zoom * Math.sqrt(Math.max(0, mean - root)), angle, 0, 2 * Math.PI);
  g.strokeStyle = colour, g.lineWidth = width, g.setLineDash(dash), g.stroke(), g.setLineDash([]);
}

// Axes in the box; returns the maps from values to the screen. axis: {min, max, log, ticks, label, format}.
function axes(g, box, ax, ay) {
  const [left, top, w, h] = box;
  const map = (a, from, length) => (v) => {
    const f = a.log ? Math.log10(v / a.min) / Math.log10(a.max / a.min) : (v - a.min) / (a.max - a.min);
    return from + length * f;
  };
  const x = map(ax, left, w), y = map(ay, top + h, -h);
  for (const t of ay.ticks) {
    line(g, [[left, y(t)], [left + w, y(t)]], ink.line, 1);
    label(g, (ay.format || String)(t).replace('-', '−'), left - 6, y(t), ink.soft, 'right');
  }
  for (const t of ax.ticks) {
    line(g, [[x(t), top + h], [x(t), top + h + 4]], ink.soft, 1);
    label(g, (ax.format || String)(t).replace('-', '−'), x(t), top + h + 13, ink.soft, 'center');
  }
  line(g, [[left, top + h], [left + w, top + h]], ink.soft, 1);
  label(g, ax.label, left + w, top + h + 29, ink.soft, 'right');
  label(g, ay.label, left - 34, top - 13, ink.soft, 'left');
  return {x, y};
}
const power = (v) => '10' + [...String(Math.round(Math.log10(v)))].map((d) => '⁰¹²³⁴⁵⁶⁷⁸⁹'[d] || '⁻').join('');

// Pointer and arrow keys on a canvas: move(x, y, first) with 0..1 of its size; keys(dx, dy, event).
function touch(id, move, keys) {
  const e = $(id);
  const at = (event, first) => {
    const b = e.getBoundingClientRect();
    move((event.clientX - b.left) / b.width, (event.clientY - b.top) / b.height, first);
  };
  e.addEventListener('pointerdown', (event) => { e.setPointerCapture(event.pointerId), at(event, true); });
  e.addEventListener('pointermove', (event) => { if (e.hasPointerCapture(event.pointerId)) at(event, false); });
  e.addEventListener('keydown', (event) => {
    const d = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]}[event.key];
    if (d && keys) event.preventDefault(), keys(d[0], d[1], event);
  });
}
const clamp = (v, a, b) => Math.min(b, Math.max(a, v));

// ------------------------------------------------------------------ 1: one Gaussian

const one = chapters.one = {
  x: 60, y: 45, held: null,
  inputs() {
    const s = (n) => slider(this.section, n);
    return [this.x, this.y, s('depth'), s('angle'), s('tilt'), s('s1'), s('s2'), s('s3'), s('opacity'), s('row') + 0.5];
  },
  update() {
    call('one_gaussian', this.inputs());
    show(this.section);
    const a = pen('one-image'), g = a.g, zoom = a.w / 120, row = this.inputs()[9], paper = parse(ink.field), paint = parse(ink.accent);
    pixels(g, 120, 90, [0, 0, a.w, a.h], (i) => paper.map((p, k) => p + (paint[k] - p) * FIELD[i]));
    line(g, [[0, row * zoom], [a.w, row * zoom]], ink.c1, 1.5, [5, 4]);
    if (a.w > 480) label(g, 'alpha is read along this line', 8, row * zoom + (row > 80 ? -10 : 10), ink.c1, 'left', true);
    if (OUT[12]) {
      const x = this.x * zoom, y = this.y * zoom;
      g.strokeStyle = ink.soft, g.lineWidth = 1, g.setLineDash([2, 3]);
      g.strokeRect(x - OUT[10] * zoom, y - OUT[11] * zoom, 2 * OUT[10] * zoom, 2 * OUT[11] * zoom), g.setLineDash([]);
      for (const k of [1, 2, 3]) ellipse(g, x, y, OUT[0], OUT[1], OUT[2], k, zoom, ink.ink, k === 1 ? 1.8 : 0.9);
      for (const h of this.handles(zoom)) {
        g.beginPath(), g.arc(h.x, h.y, 6, 0, 2 * Math.PI), g.fillStyle = ink.field, g.fill(), g.strokeStyle = ink.ink, g.lineWidth = 1.8, g.stroke();
      }
    } else label(g, 'not in view', a.w / 2, 20, ink.warn, 'center', true);
    const p = pen('one-line'), box = [40, 24, p.w - 56, p.h - 66];
    const m = axes(p.g, box, {min: 0, max: 120, ticks: [0, 30, 60, 90, 120], label: 'x on the line, px'},
      {min: 0, max: 1, ticks: [0, 0.5, 1], label: 'alpha'});
    const points = [];
    for (let i = 0; i < 120; i++) points.push([m.x(i), m.y(OUT[14 + i])], [m.x(i + 1), m.y(OUT[14 + i])]);
    line(p.g, points, ink.c1, 1.8);
  },
  // Ends of the longer and the shorter axis, at 2 standard deviations, in screen px.
  handles(zoom) {
    const a = OUT[9] * Math.PI / 180, x = this.x * zoom, y = this.y * zoom;
    return [{k: 'centre', x, y}, {k: 'long', x: x + 2 * OUT[7] * zoom * Math.cos(a), y: y + 2 * OUT[7] * zoom * Math.sin(a)},
      {k: 'short', x: x - 2 * OUT[8] * zoom * Math.sin(a), y: y + 2 * OUT[8] * zoom * Math.cos(a)}];
  },
  set(name, value) {
    const e = this.section.querySelector(`input[name=${name}]`);
    e.value = e.dataset.log !== undefined ? Math.log10(value) : value;
  },
  start() {
    touch('one-image', (u, v, first) => {
      const e = $('one-image'), w = e.clientWidth, zoom = w / 120, x = u * w, y = v * e.clientHeight;
      const s = (n) => slider(this.section, n);
      if (first) { // s1 is the axis at `angle`: the longer one on the image or the shorter
        call('one_gaussian', this.inputs());
        const near = this.handles(zoom).map((h) => [Math.hypot(h.x - x, h.y - y), h.k]).sort((a, b) => a[0] - b[0])[0];
        this.held = near[0] < 26 ? near[1] : 'centre', this.first = s('s1') >= s('s2');
      }
      if (this.held === 'centre') this.x = clamp(u * 120, -20, 140), this.y = clamp(v * 90, -20, 110);
      else {
        const dx = x / zoom - this.x, dy = y / zoom - this.y, reach = Math.hypot(dx, dy) / 2 / 120 * s('depth');
        const turn = Math.atan2(dy, dx) * 180 / Math.PI + ((this.held === 'long') === this.first ? 0 : -90);
        this.set('angle', ((turn + 450) % 180) - 90), this.set((this.held === 'long') === this.first ? 's1' : 's2', clamp(reach, 0.002, 0.6));
      }
      update('one');
    }, (dx, dy) => { this.x = clamp(this.x + dx, -20, 140), this.y = clamp(this.y + dy, -20, 110), update('one'); });
  },
};

// ------------------------------------------------------------------ 2: compositing

const layers = chapters.layers = {
  x: 47, y: 35,
  inputs() { return [this.x, this.y, slider(this.section, 'logit'), slider(this.section, 'count')]; },
  update() {
    call('compositing', this.inputs());
    show(this.section);
    const a = pen('layers-image'), zoom = a.w / 96;
    pixels(a.g, 96, 72, [0, 0, a.w, a.h], fieldRgb(0));
    cross(a.g, (this.x + 0.5) * zoom, (this.y + 0.5) * zoom, zoom);
    $('layers-colour').style.background = css3(OUT);
    [...$('layers-steps').rows].forEach((row, i) => {
      const o = OUT.subarray(5 + 10 * i), state = row.cells[5];
      row.className = o[8] === 1 ? '' : 'off';
      row.cells[0].firstElementChild.style.background = o[3] === 0 && o[9] === 0 && o[1] === 0 ? 'transparent' : css3(o.subarray(5));
      state.textContent = o[1] === 0 ? 'left out' : o[8] === 1 ? '' : o[8] === 0 ? 'skipped' : 'ends here';
    });
    let ended = false;
    [...$('layers-steps').rows].forEach((row, i) => {
      if (ended) row.cells[5].textContent = 'not read';
      ended = ended || OUT[5 + 10 * i + 8] === -1;
    });
    const p = pen('layers-bar'), g = p.g, w = p.w - 2;
    let x = 1;
    const part = (share, colour, name) => {
      g.fillStyle = colour, g.fillRect(x, 2, share * w, 30), g.strokeStyle = ink.field, g.lineWidth = 1, g.strokeRect(x, 2, share * w, 30);
      if (share * w > 16) label(g, name, x + share * w / 2, 43, ink.soft, 'center');
      x += share * w;
    };
    for (let i = 0; i < 8; i++) part(OUT[5 + 10 * i + 4], css3(OUT.subarray(5 + 10 * i + 5)), String(i + 1));
    part(OUT[3], 'rgb(13,64,89)', 'b');
  },
  start() {
    let rows = '';
    for (let i = 0; i < 8; i++) {
      const o = 5 + 10 * i;
      rows += `<tr><td><span class=swatch></span> ${i + 1}</td><td>${output(o + 1, 1)}</td><td>${output(o + 2, 4)}</td><td>${output(o + 3, 4)}</td>` +
        `<td>${output(o + 4, 4)}</td><td></td></tr>`;
    }
    $('layers-steps').innerHTML = rows;
    const go = (x, y) => { this.x = clamp(x, 0, 95), this.y = clamp(y, 0, 71), update('layers'); };
    touch('layers-image', (u, v) => go(Math.floor(u * 96), Math.floor(v * 72)), (dx, dy) => go(this.x + dx, this.y + dy));
  },
};
function cross(g, x, y, zoom) {
  g.lineWidth = 3, g.strokeStyle = '#fff', g.strokeRect(x - zoom, y - zoom, 2 * zoom, 2 * zoom);
  g.lineWidth = 1.2, g.strokeStyle = '#000', g.strokeRect(x - zoom, y - zoom, 2 * zoom, 2 * zoom);
}

// ------------------------------------------------------------------ 3: gradients

const WANTED = [[1, 1, 1], [0.02, 0.02, 0.02], [0.95, 0.45, 0.1], [0.1, 0.35, 0.8]];
const gradients = chapters.gradients = {
  x: 46, y: 37, chosen: 0, layer: [[36, 34, 25, 12, 6, 0.7], [56, 30, -35, 14, 8, 0.75], [50, 46, 5, 18, 9, 0.85]],
  inputs() { return [this.x, this.y, ...WANTED[picked(this.section, 'wanted')], this.chosen, ...this.layer[this.chosen]]; },
  update() {
    if (picked(this.section, 'gaussian') !== this.chosen) { // the sliders now show the other Gaussian, which starts as it was
      this.layer = [[36, 34, 25, 12, 6, 0.7], [56, 30, -35, 14, 8, 0.75], [50, 46, 5, 18, 9, 0.85]];
      this.chosen = picked(this.section, 'gaussian');
      ['gx', 'gy', 'angle', 's1', 's2', 'opacity'].forEach((n, k) => { this.section.querySelector(`input[name=${n}]`).value = this.layer[this.chosen][k]; });
      labelSliders(this.section);
    }
    ['gx', 'gy', 'angle', 's1', 's2', 'opacity'].forEach((n, k) => { this.layer[this.chosen][k] = slider(this.section, n); });
    call('gradients', this.inputs());
    show(this.section);
    $('gradients-colour').style.background = css3(OUT), $('gradients-wanted').style.background = css3(WANTED[picked(this.section, 'wanted')]);
    const a = pen('gradients-image'), g = a.g, zoom = a.w / 96, colours = [ink.c1, ink.c2, ink.c3];
    pixels(g, 96, 72, [0, 0, a.w, a.h], fieldRgb(0));
    const at = (i, k) => OUT[32 + 11 * i + k];
    let far = 1e-12, grow = 1e-12, turn = 1e-12, tint = 1e-12;
    for (let i = 0; i < 3; i++) {
      far = Math.max(far, Math.hypot(at(i, 2), at(i, 3))), grow = Math.max(grow, Math.abs(at(i, 4)), Math.abs(at(i, 5)));
      turn = Math.max(turn, Math.abs(at(i, 6)));
      for (let k = 7; k < 11; k++) tint = Math.max(tint, Math.abs(at(i, k)));
    }
    for (let i = 0; i < 3; i++) {
      const l = this.layer[i], x = at(i, 0) * zoom, y = at(i, 1) * zoom, t = l[2] * Math.PI / 180;
      g.save(), g.shadowColor = '#fff', g.shadowBlur = 3;
      g.beginPath(), g.ellipse(x, y, l[3] * zoom, l[4] * zoom, t, 0, 2 * Math.PI), g.strokeStyle = '#10181c', g.lineWidth = i === this.chosen ? 2.4 : 1, g.stroke();
      const reach = Math.hypot(at(i, 2), at(i, 3)) || 1, ux = -at(i, 2) / reach, uy = -at(i, 3) / reach;
      arrow(g, x + 10 * ux, y + 10 * uy, 50 * ux * reach / far, 50 * uy * reach / far, '#10181c', 3);
      for (let k = 0; k < 2; k++)
        for (const side of [-1, 1]) {
          const ux = side * (k ? -Math.sin(t) : Math.cos(t)), uy = side * (k ? Math.cos(t) : Math.sin(t)), d = -at(i, 4 + k) / grow * 26;
          arrow(g, x + ux * l[3 + k] * zoom, y + uy * l[3 + k] * zoom, ux * d, uy * d, '#7a2e8a', 2.2);
        }
      const sweep = -at(i, 6) / turn * 0.9, r = (l[3] + 4) * zoom;
      if (Math.abs(sweep) > 0.04) {
        g.beginPath(), g.arc(x, y, r, t, t + sweep, sweep < 0), g.strokeStyle = '#0b5fa5', g.lineWidth = 2.2, g.stroke();
        const e = t + sweep, s = Math.sign(sweep);
        arrow(g, x + r * Math.cos(e) + s * Math.sin(e) * 5, y + r * Math.sin(e) - s * Math.cos(e) * 5, -s * Math.sin(e) * 6, s * Math.cos(e) * 6, '#0b5fa5', 2.2);
      }
      g.restore();
      g.beginPath(), g.arc(x, y, 9, 0, 7), g.fillStyle = '#fffd', g.fill(), label(g, 'ABC'[i], x, y, '#10181c', 'center');
    }
    cross(g, (this.x + 0.5) * zoom, (this.y + 0.5) * zoom, zoom);
    const p = pen('gradients-bars'), names = ['opacity', 'red', 'green', 'blue'], wide = p.w / 3;
    for (let i = 0; i < 3; i++) {
      const left = i * wide + 6, zero = left + 48 + (wide - 66) / 2, half = (wide - 66) / 2;
      label(p.g, 'Gaussian ' + 'ABC'[i], left, 10, ink.ink);
      line(p.g, [[zero, 22], [zero, 102]], ink.line, 1);
      for (let k = 0; k < 4; k++) {
        const d = -at(i, 7 + k) / tint * half, y = 34 + 19 * k;
        label(p.g, names[k], left, y, ink.soft);
        p.g.fillStyle = [ink.soft, '#c8362b', '#2f8f4a', '#2f6fd0'][k], p.g.fillRect(Math.min(zero, zero + d), y - 5, Math.abs(d), 10);
      }
    }
    label(p.g, 'right of the line: descent increases it', 6, 114, ink.soft);
  },
  start() {
    const names = ['mean x', 'mean y', 'mean z', 'log scale 1', 'log scale 2', 'log scale 3', 'rotation w', 'rotation x', 'rotation y', 'rotation z', 'opacity logit',
      'red', 'green', 'blue'];
    const groups = [0, 3, 6, 10, 11];
    $('gradients-table').innerHTML = names.map((n, i) => `<tr${groups.includes(i) ? ' class=group' : ''}><td>${n}</td><td>${output(4 + i, 'e4')}</td><td>${output(18 + i, 'e4')}</td></tr>`).join('');
    const go = (x, y) => { this.x = clamp(x, 0, 95), this.y = clamp(y, 0, 71), update('gradients'); };
    touch('gradients-image', (u, v) => go(Math.floor(u * 96), Math.floor(v * 72)), (dx, dy) => go(this.x + dx, this.y + dy));
  },
};

// ------------------------------------------------------------------ 4, 5: fitting, density control

function runner(c, name, tick) {
  let frame = 0;
  c.running = false;
  const go = () => {
    if (!c.running) return;
    tick(), update(name);
    if (c.running) frame = still.matches ? setTimeout(go, 500) : requestAnimationFrame(go);
  };
  c.stop = () => { c.running = false, cancelAnimationFrame(frame), clearTimeout(frame), $(name + '-run').textContent = 'Run'; };
  $(name + '-run').onclick = () => {
    if (c.running) return c.stop();
    c.running = true, $(name + '-run').textContent = 'Pause', go();
  };
}
const target = chapters.fit = {
  curve: [],
  reset() {
    call('fit_select', [0]), call('fit_reset', [slider(this.section, 'count'), this.seed, 2]);
    this.curve = [];
  },
  seed: 1,
  step(n) {
    const rate = slider(this.section, 'rate');
    call('fit_select', [0]);
    for (let i = 0; i < n; i++) {
      call('fit_run', [rate, 1]);
      if (i === n - 1 || !still.matches) call('fit_show'), this.curve.push([OUT[2] - 1, OUT[0], rate]);
    }
  },
  update() {
    call('fit_select', [0]), call('fit_show');
    show(this.section);
    const a = pen('fit-model'), b = pen('fit-target');
    pixels(a.g, 48, 36, [0, 0, a.w, a.h], fieldRgb(0));
    pixels(b.g, 48, 36, [0, 0, b.w, b.h], fieldRgb(5184));
    if (this.section.querySelector('input[name=ellipses]').checked)
      for (let i = 0; i < OUT[3]; i++) {
        const o = OUT.subarray(9 + 8 * i);
        if (o[5] > 0.02) ellipse(a.g, o[0] * a.w / 48, o[1] * a.w / 48, o[2], o[3], o[4], 1, a.w / 48, `rgba(0,0,0,${0.15 + 0.6 * o[5]})`, 1);
      }
    const p = pen('fit-curve'), last = Math.max(200, this.curve.length ? this.curve[this.curve.length - 1][0] : 0), step = last > 2000 ? 1000 : last > 800 ? 400 : last > 400 ? 200 : 100;
    const ticks = [];
    for (let t = 0; t <= last; t += step) ticks.push(t);
    const m = axes(p.g, [46, 24, p.w - 60, p.h - 66], {min: 0, max: last, ticks, label: 'step'},
      {min: 0.001, max: 1, log: true, ticks: [0.001, 0.01, 0.1, 1], format: power, label: 'loss'});
    line(p.g, this.curve.map(([s, l]) => [m.x(s), m.y(clamp(l, 0.001, 1))]), ink.accent, 1.8);
  },
  start() {
    runner(this, 'fit', () => this.step(still.matches ? 25 : 1));
    $('fit-step').onclick = () => { this.stop(), this.step(1), update('fit'); };
    $('fit-reset').onclick = () => { this.stop(), this.reset(), update('fit'); };
    this.section.querySelector('input[name=count]').addEventListener('input', () => { this.stop(), this.reset(), update('fit'); });
    this.reset();
  },
};

const density = chapters.density = {
  left: 0, log: [],
  reset() {
    call('fit_select', [1]), call('fit_reset', [24, 3, 4]);
    this.log = [];
  },
  step() {
    call('fit_select', [1]), call('fit_run', [4, 1]);
    if (--this.left <= 0) this.stop();
  },
  update() {
    call('fit_select', [1]), call('fit_show');
    show(this.section);
    $('density-control').disabled = OUT[4] < 1 || this.running;
    const colours = [ink.warn, ink.soft, ink.c1], a = pen('density-image'), z = a.w / 48, g = a.g;
    pixels(g, 48, 36, [0, 0, a.w, a.h], fieldRgb(0));
    g.fillStyle = ink.field + 'a0', g.fillRect(0, 0, a.w, a.h);
    const values = [];
    for (let i = 0; i < OUT[3]; i++) {
      const o = OUT.subarray(9 + 8 * i), v = OUT[4] ? o[7] : 1;
      ellipse(g, o[0] * z, o[1] * z, o[2], o[3], o[4], 1, z, colours[v], v === 1 ? 1 : 2.2);
      values.push([o[6], v]);
    }
    const p = pen('density-bars'), box = [50, 24, p.w - 64, p.h - 66];
    const m = axes(p.g, box, {min: 0, max: Math.max(24, values.length), ticks: [], label: 'Gaussians, largest gradient first'},
      {min: 1e-6, max: 0.1, log: true, ticks: [1e-6, 1e-4, 1e-2], format: power, label: 'mean |dL/d(centre)|, half images'});
    values.sort((u, v) => v[0] - u[0]);
    values.forEach(([v, k], i) => {
      if (v <= 1e-6) return;
      p.g.fillStyle = colours[k];
      p.g.fillRect(m.x(i) + 0.5, m.y(Math.min(0.1, v)), Math.max(0.8, m.x(1) - m.x(0) - 1), box[1] + box[3] - m.y(Math.min(0.1, v)));
    });
    line(p.g, [[box[0], m.y(2e-4)], [box[0] + box[2], m.y(2e-4)]], ink.ink, 1.2, [5, 4]);
    label(p.g, 'threshold 2·10⁻⁴', box[0] + box[2], m.y(2e-4) - 9, ink.ink, 'right', true);
  },
  start() {
    runner(this, 'density', () => {
      if (still.matches) for (let i = 0; i < 24 && this.left > 1; i++) this.left--, call('fit_select', [1]), call('fit_run', [4, 1]);
      this.step();
    });
    const run = $('density-run'), click = run.onclick;
    run.onclick = () => { if (!this.running) this.left = 60; click(); };
    const stop = this.stop;
    this.stop = () => { stop(), run.textContent = 'Train 60 steps'; };
    $('density-control').onclick = () => { this.stop(), call('fit_select', [1]), call('fit_densify'), update('density'); };
    $('density-reset').onclick = () => { this.stop(), this.reset(), update('density'); };
    this.reset();
  },
};

// ------------------------------------------------------------------ 6: underwater, second lobe

const water = chapters.water = {
  inputs() {
    const s = (n) => slider(this.section, n), t = s('turbid');
    return [0.42 * t, 0.12 * t, 0.08 * t, s('sun'), s('lamp'), 0.02, 0.26, 0.34, 0.85, 0.72, 0.55, s('mid'), s('far'), s('range')];
  },
  update() {
    call('underwater', this.inputs());
    const inputs = this.inputs(), range = inputs[13], names = ['red', 'green', 'blue'], colours = [ink.warn, ink.c3, ink.c2];
    show($('water-values'));
    $('water-colour').style.background = css3(OUT);
    const at = (i, k) => FIELD[8 * i + k];
    const ax = {min: 0, max: 10, ticks: [0, 2, 4, 6, 8, 10], label: 'distance from the camera, m'};
    const p = pen('water-colours'), box = [40, 24, p.w - 56, p.h - 92], m = axes(p.g, box, ax, {min: 0, max: 1.2, ticks: [0, 0.4, 0.8, 1.2], label: 'colour that the camera sees, 0 to 1'});
    p.g.save(), p.g.beginPath(), p.g.rect(box[0], box[1], box[2], box[3]), p.g.clip();
    for (let c = 0; c < 3; c++) line(p.g, Array.from({length: 96}, (_, i) => [m.x(at(i, 0)), m.y(at(i, 1 + c))]), colours[c], 1.9);
    p.g.restore();
    for (let c = 0; c < 3; c++) label(p.g, names[c], box[0] + box[2] - 4, 34 + 16 * c, colours[c], 'right', true);
    line(p.g, [[m.x(range), box[1]], [m.x(range), box[1] + box[3]]], ink.ink, 1, [4, 4]);
    for (let i = 0; i < 96; i++) p.g.fillStyle = css3([at(i, 1), at(i, 2), at(i, 3)]), p.g.fillRect(m.x(at(i, 0)) - box[2] / 190, p.h - 26, box[2] / 95 + 1, 22);
    const q = pen('water-gradients'), b2 = [50, 24, q.w - 66, q.h - 66];
    const n = axes(q.g, b2, ax, {min: 1e-6, max: 1e-2, log: true, ticks: [1e-6, 1e-5, 1e-4, 1e-3, 1e-2], format: power, label: 'mean gradient of a Gaussian'});
    for (const [z, t] of [[1.5, 'near: 1'], [4.5, 'mid'], [8, 'far']]) label(q.g, t, n.x(z), b2[1] + 8, ink.soft, 'center');
    for (const z of [3, 6]) line(q.g, [[n.x(z), b2[1]], [n.x(z), b2[1] + b2[3]]], ink.line, 1);
    const curve = (k, colour, width, dash) => line(q.g, Array.from({length: 96}, (_, i) => [n.x(at(i, 0)), n.y(clamp(at(i, k), 1e-6, 1e-2))]), colour, width, dash);
    line(q.g, [[b2[0], n.y(2e-4)], [b2[0] + b2[2], n.y(2e-4)]], ink.ink, 1.2, [5, 4]);
    label(q.g, 'threshold 2·10⁻⁴', b2[0] + 4, n.y(2e-4) + 10, ink.ink, 'left', true);
    curve(6, ink.soft, 1.6), curve(7, ink.accent, 2.2);
    line(q.g, [[n.x(range), b2[1]], [n.x(range), b2[1] + b2[3]]], ink.ink, 1, [4, 4]);
  },
  start() {},
};

const lobe = chapters.lobe = {
  inputs() { const s = (n) => slider(this.section, n); return [s('o'), s('sigma'), s('ratio'), s('wider')]; },
  update() {
    call('second_lobe', this.inputs());
    show(this.section);
    const p = pen('lobe-profile'), box = [46, 24, p.w - 62, p.h - 66];
    const m = axes(p.g, box, {min: -60, max: 60, ticks: [-60, -30, 0, 30, 60], label: 'distance from the centre, px'}, {min: -0.2, max: 1, ticks: [0, 0.5, 1], label: 'alpha'});
    for (const [from, colour, width, dash] of [[0, ink.soft, 1.8, [6, 4]], [240, ink.accent, 2.2, []]]) {
      const half = Array.from({length: 240}, (_, i) => [i / 4, FIELD[from + i]]);
      line(p.g, [...half.slice(1).reverse().map(([x, v]) => [m.x(-x), m.y(v)]), ...half.map(([x, v]) => [m.x(x), m.y(v)])], colour, width, dash);
    }
    const x = Math.min(m.x(34), p.w - 4 - p.g.measureText('with second lobe').width);
    label(p.g, 'one Gaussian', x, m.y(0.88), ink.soft, 'left', true);
    label(p.g, 'with second lobe', x, m.y(0.76), ink.accent, 'left', true);
    line(p.g, [[x - 4, m.y(0.88)], [x - 22, m.y(0.88)]], ink.soft, 1.8, [6, 4]);
    line(p.g, [[x - 4, m.y(0.76)], [x - 22, m.y(0.76)]], ink.accent, 2.2);
  },
  start() {},
};

// ------------------------------------------------------------------ 7: partition

const blocks = chapters.blocks = {
  cuts: [], cursor: [30, 20],
  inputs() { return [this.cuts.length, ...this.cuts.flat()]; },
  update() {
    call('partition', this.inputs());
    const count = OUT[0];
    let rows = '';
    for (let b = 0; b < count; b++) rows += `<tr><td>${String.fromCharCode(65 + b)}</td><td>${output(3 + 6 * b + 4, 0)}</td><td>${output(3 + 6 * b + 5, 0)}</td></tr>`;
    $('blocks-table').innerHTML = rows;
    show(this.section);
    $('blocks-undo').disabled = !this.cuts.length, $('blocks-auto').disabled = count > 22;
    const a = pen('blocks-map'), g = a.g, z = (a.w - 2) / 60;
    const x = (v) => 1 + v * z, y = (v) => 1 + v * z;
    g.fillStyle = ink.soft;
    for (let i = 0; i < 700; i++) g.fillRect(x(FIELD[2 * i]) - 1, y(FIELD[2 * i + 1]) - 1, 2, 2);
    g.fillStyle = ink.c1;
    for (let i = 0; i < 84; i++) {
      const cx = x(FIELD[1400 + 2 * i]), cy = y(FIELD[1400 + 2 * i + 1]);
      g.beginPath(), g.moveTo(cx, cy - 4), g.lineTo(cx + 3.6, cy + 3), g.lineTo(cx - 3.6, cy + 3), g.fill();
    }
    for (let b = 0; b < count; b++) {
      const o = OUT.subarray(3 + 6 * b);
      g.strokeStyle = ink.accent, g.lineWidth = 2, g.strokeRect(x(o[0]), y(o[1]), (o[2] - o[0]) * z, (o[3] - o[1]) * z);
      g.font = '600 14px ' + css('--sans'), label(g, String.fromCharCode(65 + b), x(o[0]) + 7, y(o[1]) + 13, ink.accent, 'left', true);
      g.font = '12.5px ' + css('--sans');
    }
    const [u, v] = this.cursor;
    if (document.activeElement === a.e) line(g, [[x(u) - 8, y(v)], [x(u) + 8, y(v)]], ink.ink, 1.5), line(g, [[x(u), y(v) - 8], [x(u), y(v) + 8]], ink.ink, 1.5);
  },
  add(u, v, axis) { if (this.cuts.length < 15) this.cuts.push([u, v, axis]), update('blocks'); },
  start() {
    const axis = () => picked(this.section, 'axis');
    const place = () => { const [u, v] = this.cursor; this.add(u, v, axis()); };
    let down = null;
    const e = $('blocks-map');
    touch('blocks-map', (u, v, first) => { this.cursor = [clamp(u * 60, 0.1, 59.9), clamp(v * 40, 0.1, 39.9)]; if (first) down = this.cursor; },
      (dx, dy) => { this.cursor = [clamp(this.cursor[0] + dx, 0.1, 59.9), clamp(this.cursor[1] + dy, 0.1, 39.9)], update('blocks'); });
    e.addEventListener('pointerup', () => { if (down) down = null, place(); });
    e.addEventListener('keydown', (event) => { if (event.key === 'Enter' || event.key === ' ') event.preventDefault(), place(); });
    e.addEventListener('focus', () => update('blocks')), e.addEventListener('blur', () => update('blocks'));
    $('blocks-undo').onclick = () => { this.cuts.pop(), update('blocks'); };
    $('blocks-clear').onclick = () => { this.cuts = [], update('blocks'); };
    $('blocks-auto').onclick = () => { // the block of the most points
      call('partition', this.inputs());
      let most = 0;
      for (let b = 1; b < OUT[0]; b++) if (OUT[3 + 6 * b + 4] > OUT[3 + 6 * most + 4]) most = b;
      const o = OUT.subarray(3 + 6 * most);
      this.add((o[0] + o[2]) / 2, (o[1] + o[3]) / 2, -1);
    };
  },
};

// ------------------------------------------------------------------ numerics

chapters.needle = {
  inputs() { return [slider(this.section, 'ratio'), slider(this.section, 'turn')]; },
  update() {
    call('needle', this.inputs());
    show(this.section);
    const p = pen('needle-errors'), box = [50, 24, p.w - 66, p.h - 66];
    const m = axes(p.g, box, {min: 0, max: 6, ticks: [0, 1, 2, 3, 4, 5, 6], format: (v) => power(10 ** v), label: 'length : width of the needle'},
      {min: 1e-8, max: 10, log: true, ticks: [1e-8, 1e-6, 1e-4, 1e-2, 1], format: power, label: 'largest relative error of the determinant'});
    const curve = (k) => Array.from({length: 61}, (_, i) => [m.x(FIELD[3 * i]), m.y(clamp(FIELD[3 * i + k], 1e-8, 10))]);
    line(p.g, curve(1), ink.c1, 2.2), line(p.g, curve(2), ink.accent, 2.2);
    label(p.g, 'xx yy − xy²', m.x(2.4), m.y(3e-3), ink.c1, 'left', true);
    label(p.g, '|b₀ × b₁|² + h (…)', m.x(3.4), m.y(1.2e-6), ink.accent, 'left', true);
    const r = this.inputs()[0];
    line(p.g, [[m.x(r), box[1]], [m.x(r), box[1] + box[3]]], ink.ink, 1, [4, 4]);
  },
  start() {},
};
chapters.sums = {
  inputs() { return [slider(this.section, 'threads'), slider(this.section, 'order')]; },
  update() {
    call('summation', this.inputs());
    show(this.section);
    $('sums-order').textContent = [...FIELD.subarray(0, this.inputs()[0])].map((v) => v + 1).join(', ');
  },
  start() {},
};
chapters.growth = {
  inputs() { return [-slider(this.section, 'negative'), slider(this.section, 'layers')]; },
  update() {
    call('growth', this.inputs());
    show(this.section);
    const n = this.inputs()[1], p = pen('growth-curve'), box = [46, 24, p.w - 62, p.h - 66];
    const m = axes(p.g, box, {min: 0, max: 200, ticks: [0, 50, 100, 150, 200], label: 'layers passed'},
      {min: 1, max: 1e12, log: true, ticks: [1, 1e4, 1e8, 1e12], format: power, label: 'transmittance T'});
    const curve = (from) => Array.from({length: n}, (_, i) => [m.x(i + 1), m.y(Math.min(1e12, FIELD[from + i]))]);
    line(p.g, curve(200), ink.c1, 2.2), line(p.g, curve(0), ink.accent, 2.2);
    label(p.g, 'without a limit', box[0] + 6, m.y(1e10), ink.c1, 'left', true), label(p.g, 'with the limit of 16', box[0] + 6, m.y(1e9), ink.accent, 'left', true);
  },
  start() {},
};

// ------------------------------------------------------------------ start

async function begin() {
  const bytes = Uint8Array.from(atob($('module').textContent.trim()), (c) => c.charCodeAt(0));
  const {instance} = await WebAssembly.instantiate(bytes, {});
  C = instance.exports;
  IN = new Float64Array(C.memory.buffer, C.course_in(), 64);
  OUT = new Float64Array(C.memory.buffer, C.course_out(), 8192);
  FIELD = new Float64Array(C.memory.buffer, C.course_field(), 3 * 120 * 90);
  readColours();
  for (const [name, c] of Object.entries(chapters)) {
    c.section = $(name);
    c.section.addEventListener('input', () => update(name));
    c.start(), update(name);
  }
  const again = () => { readColours(); for (const name in chapters) update(name); };
  let width = innerWidth;
  addEventListener('resize', () => { if (innerWidth !== width) width = innerWidth, again(); });
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', again);
  document.fonts && document.fonts.ready.then(again);
  if (record) examine();
}

// Moves every slider to several places, trains, cuts; writes all calls, results and displayed texts to a <pre> that numbers.c compares with
// the native build, and the shortest of several frames of each chapter.
function examine() {
  let seed = 1;
  const random = () => (seed = (seed * 1103515245 + 12345) % 2147483648) / 2147483648;
  const times = [];
  for (const [name, c] of Object.entries(chapters)) {
    for (let turn = 0; turn < 4; turn++) {
      record.push(`chapter ${name}`);
      if (turn) {
        for (const e of c.section.querySelectorAll('input[type=range]')) {
          const low = +e.min, high = +e.max, step = +e.step || 1;
          e.value = low + step * Math.floor(random() * ((high - low) / step + 1));
        }
        const radios = c.section.querySelectorAll('input[type=radio]');
        if (radios.length) radios[Math.floor(random() * radios.length)].checked = true;
        if (name === 'one') c.x = 120 * random(), c.y = 90 * random();
        if (name === 'layers' || name === 'gradients') c.x = 20 + Math.floor(56 * random()), c.y = 20 + Math.floor(32 * random());
        if (name === 'blocks') c.cuts.push([60 * random(), 40 * random(), Math.floor(3 * random()) - 1]);
        if (name === 'fit') c.reset(), c.step(2);
        if (name === 'density') call('fit_select', [1]), call('fit_run', [4, 2]), call('fit_densify');
      }
      update(name);
    }
    const saved = record.length;
    let least = Infinity;
    for (let i = 0; i < 60; i++) {
      const begun = performance.now();
      if (name === 'fit') c.step(1);
      if (name === 'density') call('fit_select', [1]), call('fit_run', [4, 1]);
      update(name), least = Math.min(least, performance.now() - begun);
    }
    record.length = saved;
    times.push(`frame ${name} ${least.toFixed(1)}`);
    if (name === 'fit') c.reset();
  }
  const pre = document.createElement('pre');
  pre.id = 'numbers', pre.textContent = ['\nbegin', ...record, ...times, 'end\n'].join('\n').replace(/−/g, '-');
  document.body.append(pre);
}
begin();
