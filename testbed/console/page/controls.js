// Live gains, and flying by hand with a touch stick, keys or a gamepad.
'use strict';

const STICK_MS = 50; // between two messages of a stick
const LOST_MS = 250; // without an answer for this long a stick message has failed
const DEAD = 0.12; // of a gamepad's stick, around its middle
const STEPS = 200; // of a slider
const KEYS = {
  ArrowUp: [0, 1, 0], KeyW: [0, 1, 0], ArrowDown: [0, -1, 0], KeyS: [0, -1, 0],
  ArrowLeft: [-1, 0, 0], KeyA: [-1, 0, 0], ArrowRight: [1, 0, 0], KeyD: [1, 0, 0],
  KeyQ: [0, 0, 1], KeyE: [0, 0, -1],
};
const el = id => document.getElementById(id);

const request = (what, wait_ms) => request_text(JSON.stringify(what), wait_ms);

async function request_text(body, wait_ms) {
  const gone = new AbortController(), timer = setTimeout(() => gone.abort(), wait_ms);
  try {
    const answer = await fetch('request', { method: 'POST', body, cache: 'no-store',
      headers: { 'X-Console': 'request' }, signal: gone.signal });
    if (!answer.ok) throw new Error(`${answer.status}`);
    return await answer.json();
  } finally { clearTimeout(timer); }
}

const number = value => String(Number(value.toPrecision(3)));

class Controls {
  constructor() {
    this.me = Math.random().toString(36).slice(2);
    this.now = null; // what the flight says can be changed
    this.sliders = new Map();
    this.keys = new Set();
    this.drag = [0, 0];
    this.spin = 0;
    this.flies = ''; // vehicle that this page flies by hand
    this.stamp = '0'; // newest time of the server
    this.busy = false;
    for (const name of ['gains', 'hands'])
      el(`open-${name}`).addEventListener('click', () => this.open(name, el(name).hidden));
    el('revert').addEventListener('click', () => this.tune({ type: 'Revert' }));
    el('take').addEventListener('click', () => this.take());
    el('give').addEventListener('click', () => this.give());
    document.addEventListener('keydown', event => this.key(event, true));
    document.addEventListener('keyup', event => this.key(event, false));
    addEventListener('blur', () => this.release());
    document.addEventListener('visibilitychange', () => document.hidden && this.release());
    this.pad();
    setInterval(() => this.steer(), STICK_MS);
  }

  open(name, wide) {
    if (wide && innerWidth < 1500) this.open(name === 'gains' ? 'hands' : 'gains', false); // one at a time
    el(name).hidden = !wide;
    el(`open-${name}`).setAttribute('aria-expanded', String(wide));
    document.body.classList.toggle('drawn', !el('gains').hidden || !el('hands').hidden);
  }

  begin(scene) {
    this.sliders.clear();
    el('gains-law').textContent = scene.law;
    el('who').replaceChildren(...scene.vehicles.map(one => new Option(one.name)));
    el('sliders').replaceChildren(...scene.sliders.map(one => this.slider(one)));
    if (!scene.sliders.length) el('sliders').textContent = 'This law has no parameters that may change in flight.';
  }

  slider(one) {
    const [low, high, by_decades] = one.reach, row = document.createElement('div');
    const value_of = k => by_decades ? low * (high / low) ** (k / STEPS) : low + (high - low) * k / STEPS;
    const place_of = v => STEPS * (by_decades ? Math.log(v / low) / Math.log(high / low) : (v - low) / (high - low));
    row.className = 'gain';
    row.innerHTML = '<label></label><input type="range"><input type="number" step="any"><span></span>';
    const [label, range, field, was] = row.children;
    label.textContent = one.name;
    label.htmlFor = range.id = `gain-${one.name}`;
    Object.assign(range, { min: 0, max: STEPS, step: 1, title: one.bounds });
    field.setAttribute('aria-label', `${one.name}, ${one.bounds || 'any value'}`);
    field.title = one.bounds;
    const put = value => {
      range.value = Math.max(0, Math.min(STEPS, place_of(value)));
      range.setAttribute('aria-valuetext', number(value));
      field.value = number(value);
      was.textContent = value === one.start ? '' : `start ${number(one.start)}`;
      row.classList.toggle('changed', value !== one.start);
    };
    put(one.start);
    range.addEventListener('input', () => { field.value = number(value_of(range.value)); });
    range.addEventListener('change', () => this.tune({ type: 'Tune', values: { [one.name]: Number(number(value_of(range.value))) } }));
    field.addEventListener('change', () => field.value !== '' && this.tune({ type: 'Tune', values: { [one.name]: Number(field.value) } }));
    this.sliders.set(one.name, { put, row });
    return row;
  }

  async tune(what) {
    const told = el('gains-told');
    told.className = 'warn';
    told.textContent = 'asking the flight';
    try {
      const answer = await request(what, 6000);
      told.className = answer.ok ? 'ok' : 'bad';
      told.textContent = answer.ok ? answer.words : `refused: ${answer.words.replace(/\s+/g, ' ')}`;
    } catch (error) {
      told.className = 'bad';
      told.textContent = 'no answer from this page\u2019s server';
    }
    if (told.className === 'bad') this.place();
  }

  place() {
    for (const [name, value] of Object.entries(this.now ? this.now.gains : {}))
      if (this.sliders.has(name)) this.sliders.get(name).put(value);
  }

  show(now) {
    const tools = el('tools');
    if (!now) {
      if (!tools.hidden) for (const name of ['gains', 'hands']) this.open(name, false);
      tools.hidden = true;
      this.now = null;
      this.flies = '';
      return;
    }
    const fresh = JSON.stringify(now) !== JSON.stringify(this.now);
    tools.hidden = false;
    this.now = now;
    if (!fresh) return;
    if (!el('sliders').contains(document.activeElement)) this.place();
    const changed = Object.entries(now.start).filter(([name, value]) => now.gains[name] !== value).length;
    el('open-gains').textContent = changed ? `Gains (${changed})` : 'Gains';
    el('revert').disabled = !changed;
    el('no-hands').hidden = !now.why_no_manual;
    el('no-hands').textContent = now.why_no_manual;
    el('hands-form').hidden = Boolean(now.why_no_manual);
    const flown = Object.keys(now.by);
    el('open-hands').textContent = flown.length ? `By hand: ${flown.join(', ')}` : 'By hand';
    el('open-hands').classList.toggle('on', flown.length > 0);
    if (this.flies && now.by[this.flies] && now.by[this.flies] !== this.me) {
      this.say(`another page flies ${this.flies}`, 'bad');
      this.let_go();
    }
  }

  // By hand

  say(words, level) {
    el('hands-told').textContent = words;
    el('hands-told').className = level;
  }

  take() {
    this.flies = el('who').value;
    el('who').disabled = el('take').disabled = true;
    el('give').disabled = false;
    el('pad').focus();
  }

  let_go() {
    this.flies = '';
    el('who').disabled = el('take').disabled = false;
    el('give').disabled = true;
    this.release();
  }

  async give() {
    const vehicle = this.flies;
    this.let_go();
    for (let tries = 0; tries < 5; tries++) {
      try {
        const told = await request_text(this.stamped({ ...this.message(vehicle), mode: 'law' }), 1000);
        if (told.ok) { this.say(`the law flies ${vehicle}`, 'ok'); return; }
      } catch (error) { /* asked again */ }
    }
    this.say(`${vehicle} was not given back: no answer; it rests and holds`, 'bad');
  }

  message(vehicle) {
    return { type: 'Steer', vehicle, mode: document.querySelector('[name=mode]:checked').value, by: this.me };
  }

  // With the newest time of the server, which is larger than JavaScript's numbers
  stamped(message) { return JSON.stringify(message).replace(/}$/, `,"stamp_ns":${this.stamp}}`); }

  async steer() {
    const [x, y, turn] = this.stick();
    el('knob').style.transform = `translate(${34 * x}%, ${-34 * y}%) translate(-50%, -50%)`;
    el('stick').textContent = `${Math.round(100 * x)}, ${Math.round(100 * y)} %${turn ? `, turn ${turn > 0 ? 'left' : 'right'}` : ''}`;
    if (!this.flies || this.busy) return;
    const vehicle = this.flies;
    this.busy = true;
    try {
      const told = await request_text(this.stamped({ ...this.message(vehicle), x, y, turn }), LOST_MS);
      this.stamp = told.now;
      if (this.flies !== vehicle) return;
      if (told.ok) this.say(`you fly ${vehicle}; it rests when you let go${this.pad_name ? `; gamepad ${this.pad_name}` : ''}`, 'ok');
      else this.say(told.words, 'bad');
    } catch (error) {
      if (this.flies) this.say('no connection: the vehicle comes to rest and holds', 'bad');
    } finally { this.busy = false; }
  }

  stick() {
    let [x, y] = this.drag, turn = this.spin;
    for (const code of this.keys) { const [dx, dy, dw] = KEYS[code]; x += dx; y += dy; turn += dw; }
    const one = [...(navigator.getGamepads ? navigator.getGamepads() : [])].find(Boolean);
    this.pad_name = one ? one.id.slice(0, 24) : '';
    if (one) {
      const axis = k => Math.abs(one.axes[k] || 0) > DEAD ? one.axes[k] : 0;
      x += axis(0); y -= axis(1); turn -= axis(2);
    }
    const size = Math.max(1, Math.hypot(x, y));
    return [x / size, y / size, Math.max(-1, Math.min(1, turn))];
  }

  release() {
    this.keys.clear();
    this.drag = [0, 0];
    this.spin = 0;
  }

  key(event, down) {
    const typing = ['INPUT', 'SELECT', 'TEXTAREA'].includes(event.target.tagName) && event.target.type !== 'radio';
    if (!this.flies || !KEYS[event.code] || event.ctrlKey || event.metaKey || event.altKey) return;
    if (down && typing) return;
    event.preventDefault();
    if (down) this.keys.add(event.code); else this.keys.delete(event.code);
  }

  pad() {
    const pad = el('pad');
    const place = event => {
      const box = pad.getBoundingClientRect(), half = box.width / 2;
      const x = (event.clientX - box.left - half) / half, y = -(event.clientY - box.top - half) / half;
      const size = Math.max(1, Math.hypot(x, y));
      this.drag = [x / size, y / size];
    };
    pad.addEventListener('pointerdown', event => { pad.setPointerCapture(event.pointerId); place(event); });
    pad.addEventListener('pointermove', event => pad.hasPointerCapture(event.pointerId) && place(event));
    for (const kind of ['pointerup', 'pointercancel', 'lostpointercapture'])
      pad.addEventListener(kind, () => { this.drag = [0, 0]; });
    for (const [id, spin] of [['left', 1], ['right', -1]]) {
      el(id).addEventListener('pointerdown', event => { el(id).setPointerCapture(event.pointerId); this.spin = spin; });
      for (const kind of ['pointerup', 'pointercancel', 'lostpointercapture'])
        el(id).addEventListener(kind, () => { this.spin = 0; });
    }
  }
}
