// The operator's page: asks for the newest picture again and again, shows it, and presses STOP.
'use strict';

const STALE_S = 1;
const ANSWER_MS = 2500; // without an answer for this long the page is not connected
const AGAIN_MS = 600; // a second press counts as one from then on
const $ = id => document.getElementById(id);

const controls = new Controls();
let server = '', version = -1, scene = null, top_view = null, raster = null, events = [];
let picture = null; // the newest answer
let answered = 0; // when it came [ms of this page's clock]
let linked = false;
let presses = 0, pressed_at = 0;

function show(id, words, level) {
  const one = $(id);
  one.hidden = !words;
  if (one.textContent !== words) one.textContent = words;
  if (level) for (const name of ['ok', 'warn', 'bad', 'off']) one.classList.toggle(name, name === level);
}

async function ask(url, wait_ms, options = {}) {
  const gone = new AbortController(), timer = setTimeout(() => gone.abort(), wait_ms);
  try {
    const answer = await fetch(url, { ...options, signal: gone.signal, cache: 'no-store' });
    if (!answer.ok) throw new Error(`${answer.status}`);
    return await answer.json();
  } finally { clearTimeout(timer); }
}

async function follow() {
  for (;;) {
    try {
      const news = await ask(`picture?after=${version < 0 ? '' : version}`, ANSWER_MS);
      if (server && news.server !== server) location.reload(); // another run is served here now
      server = news.server;
      linked = true;
      answered = performance.now();
      if (news.scene && !scene) await begin(); // the next answer has the whole run
      else take(news);
    } catch (error) {
      linked = false;
      refresh();
      await new Promise(done => setTimeout(done, 300));
    }
  }
}

async function begin() {
  scene = await ask('scene', ANSWER_MS);
  version = -1;
  top_view = new TopView($('top'), scene);
  raster = new Raster($('raster'), scene);
  $('name').textContent = scene.name;
  $('law').textContent = `law ${scene.law}${scene.description && ': '}${scene.description}`;
  $('of').textContent = `of ${clock(scene.duration)}`;
  document.title = `${scene.name} - testbed console`;
  controls.begin(scene);
  tiles(scene.vehicles.map(one => ({ name: one.name, state: 'not heard yet', level: 'off', numbers: [] })));
}

const clock = t => `${Math.floor(t / 60)}:${String(Math.floor(t % 60)).padStart(2, '0')}`;

function take(news) {
  const fresh = news.v !== version || news.anew;
  picture = news;
  version = news.v;
  controls.show(news.controls);
  if (fresh && scene) {
    if (news.now.vehicles) {
      top_view.trail(news.trail, news.anew);
      top_view.draw(news.now);
      raster.take(news.pulses, news.anew, news.now);
      tiles(news.now.vehicles); // the first ones leave less room for the raster
      raster.draw();
      $('clock').textContent = clock(news.now.t);
      $('progress').value = Math.min(1, news.now.t / scene.duration);
      $('valves-source').textContent = news.now.reported ? 'as the boards report' : 'as planned';
    }
    if (news.anew) events = [];
    if (news.events.length || news.anew) { events.push(...news.events); list(); }
    arming(news.checks || []);
  }
  refresh();
}

// What changes without a new picture: ages, connections, headlines
function refresh() {
  const old = picture && picture.age !== null ? picture.age + (performance.now() - answered) / 1000 : null;
  const verdict = picture && picture.verdict, now = picture && picture.now;
  const lost = !linked && !verdict; // the last picture of a finished run stays true
  const over = Boolean(verdict) || (linked && now && ['STOPPED', 'FAULT'].includes(now.phase));
  const stale = lost || (old !== null && old > STALE_S && !over);
  const ready = linked && picture && picture.stop && picture.stop.ready;
  const since = old === null ? '' : old < 10 ? `${old.toFixed(1)} s` : `${Math.round(old)} s`;
  const body = document.body.classList;
  body.toggle('stale', stale);
  body.toggle('lost', lost);
  body.toggle('cut', !lost && !ready && !over);
  body.toggle('over', over && !ready);
  show('age', over ? 'flight over' : old === null ? 'no picture' : `picture ${since} old`,
    stale ? 'bad' : old === null || over ? 'off' : 'ok');
  $('veil').textContent = !stale ? '' : `${lost ? 'not connected, ' : ''}picture is ${since} old`;
  const phase = now && now.phase || (verdict ? 'NOT STARTED' : 'GETTING READY');
  show('phase', lost ? 'not connected' : phase,
    lost ? 'bad' : { RUNNING: 'ok', FAULT: 'bad', ARMED: 'warn', 'NOT STARTED': 'bad' }[phase] || 'off');
  headline(lost, stale && ready ? `no news from the host for ${since}: STOP still works` : '', now, verdict);
  show('ways', lost ? 'this page is not connected' : over ? '' : picture && picture.stop ? picture.stop.words : 'looking for the flight',
    lost || !(ready || over) ? 'bad' : null);
  button(lost || (!ready && !over), over && !ready);
}

function headline(lost, hangs, now, verdict) {
  if (lost) show('head', 'not connected to the host', 'bad');
  else if (hangs) show('head', hangs, 'bad');
  else if (now && now.head) show('head', now.head, now.level);
  else if (verdict) show('head', verdict.words, verdict.level);
  else show('head', picture && picture.trouble || '', 'warn');
}

function button(cut, over) {
  const word = cut ? 'NOT CONNECTED' : presses && !over ? 'STOP AGAIN' : 'STOP';
  const hint = cut ? 'a press still tries' : over ? 'flight over' : presses ? 'valves and air off now' : 'key Esc';
  if ($('stop-word').textContent !== word) $('stop-word').textContent = word;
  if ($('stop-hint').textContent !== hint) $('stop-hint').textContent = hint;
  $('stop').classList.toggle('pressed', word === 'STOP AGAIN');
}

async function stop() {
  const now = performance.now();
  if (now - pressed_at < AGAIN_MS) return; // a double click is one press
  pressed_at = now;
  presses += 1;
  const name = `${Date.now()}-${Math.random().toString(36).slice(2)}`;
  show('told', presses > 1 ? 'STOP again: sending' : 'STOP: sending', 'warn');
  for (let tries = 0; tries < 10; tries++) {
    try {
      const told = await ask('stop', ANSWER_MS, { method: 'POST', body: name, headers: { 'X-Console': 'stop' } });
      $('told').dataset.heard = told.heard_ns; // by the clock of the page's process
      const all = told.sent && !told.lines.some(line => line.includes('did not'));
      show('told', `STOP: ${told.lines.join(', ')}`, all ? 'ok' : 'bad');
      if (!told.sent) presses = 0;
      return;
    } catch (error) {
      show('told', 'STOP: no answer, trying again. Else: testbed stop in a terminal, main valve by hand', 'bad');
      await new Promise(done => setTimeout(done, 200));
    }
  }
  presses = 0;
}

function tiles(vehicles) {
  const room = $('vehicles');
  room.classList.toggle('many', vehicles.length > 6);
  vehicles.forEach((told, k) => {
    let one = room.children[k];
    if (!one) {
      one = document.createElement('article');
      one.innerHTML = '<h3><i></i><span></span></h3><div class="state"></div><dl></dl>';
      one.style = hue(k);
      room.append(one);
    }
    one.className = `tile ${told.level}`;
    one.dataset.name = told.name;
    one.setAttribute('aria-label', `${told.name}: ${told.state}`);
    one.querySelector('h3 span').textContent = told.name;
    one.querySelector('.state').textContent = told.state;
    one.querySelector('.state').title = told.state;
    const list = one.querySelector('dl');
    told.numbers.forEach(([key, label, words, level, limit], n) => {
      let row = list.children[n];
      if (!row) {
        row = document.createElement('div');
        row.innerHTML = '<dt></dt><dd></dd>';
        list.append(row);
      }
      row.firstChild.textContent = label;
      row.lastChild.textContent = words;
      row.lastChild.className = level;
      row.dataset.key = key;
      row.title = limit;
    });
  });
}

function list() {
  events = events.slice(-200);
  const first = events.filter(one => one[2] === 'CRITICAL'), rest = events.filter(one => one[2] !== 'CRITICAL').reverse();
  $('lines').replaceChildren(...[...first, ...rest].slice(0, 60).map(([t, who, level, words]) => {
    const line = document.createElement('li'), when = document.createElement('time'), said = document.createElement('span');
    line.className = level;
    when.textContent = `${t.toFixed(1)} s`;
    said.textContent = who === 'supervisor' ? words : `${who}: ${words}`;
    line.append(when, said);
    return line;
  }));
}

function arming(checks) {
  const red = checks.filter(one => one.reason), room = $('arming');
  room.hidden = !checks.length;
  document.body.classList.toggle('arming', checks.length > 0);
  $('arming-title').textContent = red.length ? `Arming checks: ${red.length} red${checks.length > red.length ? `, ${checks.length - red.length} green` : ''}`
    : `Arming checks: all ${checks.length} green`;
  $('checks').replaceChildren(...red.map(one => {
    const line = document.createElement('li'), name = document.createElement('b'), to_do = document.createElement('em');
    line.className = 'bad';
    name.textContent = `✕ ${one.name}: ${one.reason}`;
    to_do.textContent = one.to_do;
    line.append(name, to_do);
    return line;
  }));
  const green = checks.filter(one => !one.reason).map(one => one.name);
  show('green', green.length ? `\u2713 ${green.join(', ')}` : '', null);
}

$('stop').addEventListener('click', stop);
document.addEventListener('keydown', event => {
  if (event.key === 'Escape' && !event.repeat) { event.preventDefault(); stop(); }
});
addEventListener('resize', () => raster && raster.draw());
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => raster && raster.draw());
setInterval(refresh, 100);
follow();
