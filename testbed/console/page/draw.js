// Draws the table from above as SVG, and the valves as a raster on a canvas.
'use strict';

const CM = 100; // SVG units per metre
const MARGIN = 14;
const RASTER_S = 10;
const PLUME = 0.26; // [m] of a jet that is open for a whole period
const SVG = 'http://www.w3.org/2000/svg';

function make(kind, attributes, parent) {
  const one = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) one.setAttribute(name, value);
  if (parent) parent.append(one);
  return one;
}

const HUES = 8; // of console.css
const hue = k => `--hue: var(--h${k % HUES})`;

// A name that fits: its middle is left out, because vehicles often differ in their last letters
function fitting(pen, name, room) {
  for (let cut = 0; cut < name.length - 2; cut++) {
    const kept = name.length - cut, head = Math.ceil(kept / 2);
    const words = cut ? `${name.slice(0, head)}\u2026${name.slice(name.length - kept + head)}` : name;
    if (pen.measureText(words).width <= room) return words;
  }
  return name.slice(-2);
}

class TopView {
  constructor(svg, scene) {
    this.scene = scene;
    const [w, h] = scene.size;
    this.x = x => (x + w / 2) * CM + MARGIN;
    this.y = y => (h / 2 - y) * CM + MARGIN;
    svg.replaceChildren();
    svg.setAttribute('viewBox', `0 0 ${w * CM + 2 * MARGIN} ${h * CM + 2 * MARGIN}`);
    svg.setAttribute('aria-label', `Table from above, ${w} m by ${h} m`);
    this.still(svg, w, h);
    this.obstacles = scene.obstacles.map(one => this.obstacle(svg, one));
    this.edges = scene.edges.filter(pair => !pair.includes('leader'))
      .map(pair => ({ pair, line: make('line', { class: 'edge' }, svg) }));
    if (scene.leader) this.polyline(svg, 'path', scene.leader, 'stroke: var(--ink)');
    scene.vehicles.forEach((one, k) => this.aims(svg, one, k));
    this.trails = scene.vehicles.map((one, k) => ({
      line: make('polyline', { class: 'trail', style: hue(k) }, svg), points: [] }));
    this.cars = scene.vehicles.map((one, k) => this.car(svg, one, k));
  }

  still(svg, w, h) {
    make('rect', { class: 'stone', x: MARGIN, y: MARGIN, width: w * CM, height: h * CM }, svg);
    for (let x = Math.ceil(-w / 2 + 0.01); x < w / 2; x++)
      make('line', { class: 'grid', x1: this.x(x), x2: this.x(x), y1: this.y(h / 2), y2: this.y(-h / 2) }, svg);
    for (let y = Math.ceil(-h / 2 + 0.01); y < h / 2; y++)
      make('line', { class: 'grid', y1: this.y(y), y2: this.y(y), x1: this.x(-w / 2), x2: this.x(w / 2) }, svg);
    const [fx, fy] = this.scene.fence;
    make('rect', { class: 'fence', x: this.x(-fx), y: this.y(fy), width: 2 * fx * CM, height: 2 * fy * CM }, svg);
  }

  obstacle(svg, one) {
    const group = make('g', { class: 'obstacle', 'data-name': one.name }, svg);
    this.put(group, one, 0);
    make('circle', { class: 'zone', r: one.radius * CM }, group);
    if (one.solid > 0) make('circle', { class: 'solid', r: one.solid * CM }, group);
    make('text', { 'text-anchor': 'middle', y: 7 }, group).textContent = one.name;
    return { one, group };
  }

  put(group, one, t) {
    const [x, y] = one.at.map((p, k) => p + t * one.velocity[k]);
    group.setAttribute('transform', `translate(${this.x(x)} ${this.y(y)})`);
  }

  polyline(svg, kind, points, style) {
    const at = points.map(([x, y]) => `${this.x(x)},${this.y(y)}`).join(' ');
    return make('polyline', { class: kind, points: at, style }, svg);
  }

  aims(svg, one, k) {
    if (one.path) this.polyline(svg, 'path', one.path, hue(k));
    if (!one.goal || one.path) return;
    const [x, y, theta] = one.goal, r = one.radius * CM, turn = -theta * 180 / Math.PI;
    const group = make('g', { class: 'goal', style: hue(k),
      transform: `translate(${this.x(x)} ${this.y(y)}) rotate(${turn})` }, svg);
    make('circle', { r }, group);
    make('path', { d: `M ${-0.35 * r} 0 H ${0.35 * r} M 0 ${-0.35 * r} V ${0.35 * r} M ${r} 0 H ${1.5 * r}` }, group);
  }

  car(svg, one, k) {
    const brake = make('path', { class: 'brake', visibility: 'hidden' }, svg);
    const aim = make('circle', { class: 'aim', r: 6, visibility: 'hidden' }, svg);
    const group = make('g', { class: 'vehicle', 'data-name': one.name, style: hue(k), visibility: 'hidden' }, svg);
    const turned = make('g', {}, group);
    const jets = one.jets.map(() => make('path', { class: 'plume' }, turned));
    const half = CM * Math.max(0.1, ...one.jets.map(([x, y]) => Math.max(Math.abs(x), Math.abs(y))));
    const c = 0.62 * half;
    make('polygon', { class: 'body', points: [[half, c], [c, half], [-c, half], [-half, c], [-half, -c], [-c, -half],
      [c, -half], [half, -c]].join(' ') }, turned);
    make('polygon', { class: 'nose', points: [[0.9 * half, 0], [-0.6 * half, 0.62 * half], [-0.25 * half, 0],
      [-0.6 * half, -0.62 * half]].join(' ') }, turned);
    const r = one.radius * CM;
    make('circle', { class: 'rim', r }, group);
    const a = 0.75 * r;
    make('path', { class: 'cross', d: `M ${-a} ${-a} L ${a} ${a} M ${-a} ${a} L ${a} ${-a}` }, group);
    const name = make('text', { 'text-anchor': 'middle', y: -r - 8 }, group);
    return { one, group, turned, jets, brake, aim, name };
  }

  trail(points, anew) {
    if (anew) this.trails.forEach(one => { one.points = []; });
    for (const [k, x, y] of points) this.trails[k].points.push(`${this.x(x).toFixed(1)},${this.y(y).toFixed(1)}`);
    for (const one of this.trails) one.line.setAttribute('points', one.points.join(' '));
  }

  draw(now) {
    const places = {};
    this.obstacles.forEach(({ one, group }) => this.put(group, one, now.t));
    now.vehicles.forEach((told, k) => { this.place(this.cars[k], told, now); places[told.name] = told.at; });
    for (const { pair: [a, b], line } of this.edges) {
      if (!places[a]?.length || !places[b]?.length) continue;
      [['1', a], ['2', b]].forEach(([end, name]) => {
        line.setAttribute(`x${end}`, this.x(places[name][0]));
        line.setAttribute(`y${end}`, this.y(places[name][1]));
      });
    }
  }

  place(car, told) {
    const seen = told.at && told.at.length > 0;
    car.group.setAttribute('visibility', seen ? 'visible' : 'hidden');
    const aim = told.reference, hidden = one => one.setAttribute('visibility', 'hidden');
    if (!seen) { hidden(car.aim); hidden(car.brake); return; }
    const [x, y, theta] = told.at;
    car.group.setAttribute('transform', `translate(${this.x(x)} ${this.y(y)})`);
    car.turned.setAttribute('transform', `rotate(${-theta * 180 / Math.PI})`);
    car.group.classList.toggle('culprit', Boolean(told.culprit));
    car.group.classList.toggle('blind', Boolean(told.stale));
    car.name.textContent = told.name + (told.culprit ? ' FAULT' : told.stale ? ' unseen' : '');
    car.jets.forEach((path, k) => {
      const share = told.jets[k] || 0, [jx, jy, px, py] = car.one.jets[k].map(v => v * CM);
      const size = share > 0 ? (0.25 + 0.75 * Math.sqrt(share)) * PLUME : 0, side = 0.05;
      path.setAttribute('d', share > 0 ? `M ${jx - side * py} ${-(jy + side * px)} L ${jx + side * py} ${-(jy - side * px)}`
        + ` L ${jx - size * px} ${-(jy - size * py)} Z` : '');
    });
    if (aim) {
      car.aim.setAttribute('visibility', 'visible');
      car.aim.setAttribute('cx', this.x(aim[0]));
      car.aim.setAttribute('cy', this.y(aim[1]));
    } else hidden(car.aim);
    const stop = told.stop;
    if (stop && Math.hypot(stop[0] - x, stop[1] - y) > 0.04) {
      const sx = this.x(stop[0]), sy = this.y(stop[1]);
      car.brake.setAttribute('visibility', 'visible');
      car.brake.setAttribute('d', `M ${this.x(x)} ${this.y(y)} L ${sx} ${sy} M ${sx - 6} ${sy - 6} l 12 12 m -12 0 l 12 -12`);
    } else hidden(car.brake);
  }
}

class Raster {
  constructor(canvas, scene) {
    this.canvas = canvas;
    this.rows = scene.vehicles.map(one => one.jets.length);
    this.names = scene.vehicles.map(one => one.name);
    this.pulses = [];
    this.t = 0;
  }

  take(pulses, anew, now) {
    if (anew) this.pulses = [];
    this.pulses.push(...pulses);
    this.t = now.t;
    this.open = now.open;
    this.pulses = this.pulses.filter(one => one[3] > this.t - RASTER_S);
  }

  draw() {
    const { canvas } = this, ratio = window.devicePixelRatio || 1, css = getComputedStyle(document.documentElement);
    const w = canvas.clientWidth, h = canvas.clientHeight;
    if (w < 1 || h < 1) return;
    if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
      canvas.width = Math.round(w * ratio);
      canvas.height = Math.round(h * ratio);
    }
    const pen = canvas.getContext('2d'), bottom = 16, colour = name => css.getPropertyValue(name).trim();
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, w, h);
    pen.font = '11px system-ui, Arial, sans-serif';
    const widest = Math.max(...this.names.map(name => pen.measureText(name).width));
    const left = Math.round(Math.max(46, Math.min(widest + 10, w / 5)));
    const names = this.names.map(name => fitting(pen, name, left - 8));
    const gap = 5, total = this.rows.reduce((a, b) => a + b, 0);
    const step = (h - bottom - gap * this.rows.length) / Math.max(1, total);
    const at = t => left + (w - left - 4) * (1 - (this.t - t) / RASTER_S);
    pen.textAlign = 'center';
    for (let s = 0; s <= RASTER_S; s += 2) {
      pen.fillStyle = colour('--grid');
      pen.fillRect(at(this.t - s), 0, 1, h - bottom);
      pen.fillStyle = colour('--soft');
      pen.fillText(s ? `-${s} s` : 'now', Math.min(at(this.t - s), w - 14), h - 4);
    }
    const tops = [];
    let y = gap / 2;
    pen.textAlign = 'left';
    this.rows.forEach((jets, k) => {
      tops.push(y);
      pen.fillStyle = colour('--grid');
      for (let jet = 0; jet < jets; jet++) pen.fillRect(left, y + (jet + 0.5) * step, w - left - 4, 0.5);
      pen.fillStyle = colour(`--h${k % HUES}`);
      pen.fillRect(left - 5, y, 3, jets * step);
      pen.fillText(names[k], 0, y + jets * step / 2 + 4);
      y += jets * step + gap;
    });
    const bars = [...this.pulses, ...(this.open || []).map(([v, j, from]) => [v, j, from, this.t])];
    for (const [vehicle, jet, from, until] of bars) {
      const a = Math.max(left, at(from)), b = Math.min(at(until), w - 4);
      if (b < left || a > w - 4) continue;
      pen.fillStyle = colour(`--h${vehicle % HUES}`);
      pen.fillRect(a, tops[vehicle] + jet * step + 0.5, Math.max(1, b - a), Math.max(1, step - 1));
    }
  }
}
