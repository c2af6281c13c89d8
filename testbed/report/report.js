// A report's scrubber: vehicles with their jets at any time, cursors and values in the figures.
"use strict";
(() => {
  const SVG = "http://www.w3.org/2000/svg", TRAIL_S = 20, PLUME = 0.3;
  const said = document.getElementById("flight");
  const flight = said ? JSON.parse(said.textContent) : null;
  let now = 0, hovered = null, playing = null;

  const make = (kind, attributes, parent) => {
    const one = document.createElementNS(SVG, kind);
    for (const [name, value] of Object.entries(attributes)) one.setAttribute(name, value);
    if (parent) parent.append(one);
    return one;
  };
  const words = (v, step) => { // no more digits than the figure resolves
    const text = v.toFixed(Math.min(8, Math.max(0, Math.ceil(-Math.log10(step)))));
    return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "\u2212");
  };

  // a figure's frame: pixels to numbers and back
  function frame(svg) {
    const [left, top, right, bottom, x0, x1, y0, y1, log] = svg.dataset.frame.split(" ").map(Number);
    const value = py => { const s = (bottom - py) / (bottom - top); return log ? y0 * (y1 / y0) ** s : y0 + s * (y1 - y0); };
    return { left, top, right, bottom, x0, x1, value, x: v => left + (right - left) * (v - x0) / (x1 - x0),
      y: v => bottom - (bottom - top) * (v - y0) / (y1 - y0), back: px => x0 + (x1 - x0) * (px - left) / (right - left),
      per: (right - left) / (x1 - x0) };
  }
  function pieces(path) { // of a line: lists of points, apart where it is interrupted
    return path.getAttribute("d").split("M").filter(Boolean).map(one => one.split("L").map(p => p.split(" ").map(Number)));
  }
  function at(line, px) {
    for (const one of line) {
      if (px < one[0][0] - 0.6 || px > one[one.length - 1][0] + 0.6) continue;
      let a = 0, b = one.length - 1;
      while (b - a > 1) { const m = (a + b) >> 1; if (one[m][0] <= px) a = m; else b = m; }
      const [xa, ya] = one[a], [xb, yb] = one[b];
      return xb > xa ? ya + (yb - ya) * Math.min(1, Math.max(0, (px - xa) / (xb - xa))) : yb;
    }
    return NaN;
  }

  const plots = [...document.querySelectorAll("figure svg[data-time]")].map(svg => {
    const f = frame(svg), out = document.createElement("p");
    out.className = "values";
    svg.after(out);
    const cursor = make("path", { class: "cursor", visibility: "hidden" }, svg);
    return { svg, f, out, cursor, lines: null };
  });

  function show(plot, t) {
    const { f, svg } = plot, over = flight && t > f.x1 && t <= f.x1 + flight.step + 1e-6; // the last tick's plan
    const px = over ? f.right : f.x(t), inside = t !== null && px >= f.left - 0.5 && px <= f.right + 0.5;
    plot.cursor.setAttribute("visibility", inside ? "visible" : "hidden");
    if (!inside) { plot.out.textContent = ""; return; }
    plot.cursor.setAttribute("d", `M${px.toFixed(1)} ${f.top}V${f.bottom}`);
    plot.lines ??= [...svg.querySelectorAll("path[data-name]")].map(path => ({
      name: path.dataset.name, hue: path.dataset.hue, line: pieces(path) }));
    const unit = svg.dataset.unit;
    plot.out.replaceChildren(`at ${t.toFixed(1)} s${unit ? `, in ${unit}` : ""}: `, ...plot.lines.flatMap(one => {
      const dot = document.createElement("span"), py = at(one.line, px);
      dot.textContent = `${one.name} ${isNaN(py) ? "\u2013" : words(f.value(py), Math.abs(f.value(py) - f.value(py + 0.1)))}`;
      dot.style.color = `var(--h${one.hue})`;
      return [dot, "  "];
    }));
  }
  const near = () => { // only figures in the window are drawn
    for (const plot of plots) {
      const box = plot.svg.getBoundingClientRect();
      if (box.bottom > -200 && box.top < innerHeight + 200) show(plot, hovered ?? (flight ? now : null));
    }
  };

  for (const plot of plots) {
    const time = event => {
      const box = plot.svg.getBoundingClientRect();
      const px = (event.clientX - box.x) / box.width * plot.svg.viewBox.baseVal.width;
      return Math.min(plot.f.x1, Math.max(plot.f.x0, plot.f.back(px)));
    };
    plot.svg.addEventListener("pointermove", event => {
      hovered = time(event);
      if (flight && event.buttons) set(hovered); else near();
    });
    plot.svg.addEventListener("pointerdown", event => { if (flight) set(time(event)); });
    plot.svg.addEventListener("pointerleave", () => { hovered = null; near(); });
  }

  // the table from above
  const top_view = document.querySelector("#trajectory svg");
  const cars = [], rocks = [];
  if (flight && top_view) {
    const f = frame(top_view), layer = make("g", { id: "live" });
    top_view.insertBefore(layer, top_view.querySelector(".hit, .names")); // below crosses and names
    top_view.classList.add("live");
    for (const rock of flight.obstacles) {
      const group = make("g", {}, layer);
      make("circle", { class: "danger", r: rock.radius * f.per }, group);
      make("circle", { class: "solid", r: rock.solid * f.per }, group);
      rocks.push({ rock, group, f });
    }
    for (const one of flight.vehicles) {
      const trail = make("path", { class: `line trail s${one.hue} ${one.style}` }, layer);
      const group = make("g", { class: `car s${one.hue} f${one.hue}`, "data-name": one.name }, layer);
      const jets = make("path", { class: "plume" }, group);
      make("circle", { class: "body", r: one.radius * f.per }, group);
      make("path", { class: "nose", d: `M0 0H${one.radius * f.per}` }, group);
      cars.push({ one, trail, group, jets, f });
    }
  }
  function pose(one, t) {
    const s = Math.min(one.x.length - 1, Math.max(0, t / flight.step)), a = Math.floor(s), b = Math.min(a + 1, one.x.length - 1);
    const mix = list => list[a] + (s - a) * (list[b] - list[a]);
    return [mix(one.x) / 1000, mix(one.y) / 1000, mix(one.turn) / 100, a];
  }
  function place({ one, trail, group, jets, f }, t) {
    const gone = t > one.end + flight.step || !one.x.length;
    group.setAttribute("visibility", one.x.length ? "visible" : "hidden");
    if (!one.x.length) return;
    const [x, y, turn, k] = pose(one, t), first = Math.max(0, k - Math.round(TRAIL_S / flight.step));
    group.setAttribute("transform", `translate(${f.x(x).toFixed(2)} ${f.y(y).toFixed(2)}) rotate(${(-turn).toFixed(1)}) scale(1 -1)`);
    let d = "";
    for (let i = first; i <= k; i++) d += `${i > first ? "L" : "M"}${f.x(one.x[i] / 1000).toFixed(1)} ${f.y(one.y[i] / 1000).toFixed(1)}`;
    trail.setAttribute("d", d);
    jets.setAttribute("d", gone ? "" : one.jets.map(([jx, jy, px, py], jet) => {
      const share = Number(one.on[k * one.jets.length + jet]) / 9 || 0;
      if (!share) return "";
      const size = (0.3 + 0.7 * Math.sqrt(share)) * PLUME * f.per, c = 0.06 * f.per;
      const [ax, ay] = [jx * f.per, jy * f.per];
      return `M${ax} ${ay}L${ax - size * px - c * py} ${ay - size * py + c * px}L${ax - size * px + c * py} ${ay - size * py - c * px}Z`;
    }).join(""));
  }

  // the bar
  const bar = document.getElementById("scrub");
  function set(t) {
    now = Math.min(flight.end, Math.max(0, t));
    bar.querySelector("input").value = now;
    bar.querySelector("output").textContent = `${now.toFixed(1)} s`;
    const past = flight.events.filter(one => one[0] <= now + 0.05);
    // of those at one time, the first is the worst
    const last = past.find(one => one[0] === past[past.length - 1][0]);
    const told = bar.querySelector(".told");
    told.textContent = last ? `${last[0].toFixed(1)} s  ${last[2]}${last[2] ? ": " : ""}${last[3]}` : "";
    told.className = `told ${last && last[0] > now - 5 ? last[1] : ""}`;
    for (const car of cars) place(car, now);
    for (const { rock, group, f } of rocks) group.setAttribute("transform", `translate(${f.x(rock.at[0] + now * rock.velocity[0])} ${f.y(rock.at[1] + now * rock.velocity[1])})`);
    near();
  }
  function play(go) {
    const button = bar.querySelector("button.play");
    button.textContent = go ? "\u275a\u275a" : "\u25b6";
    button.setAttribute("aria-label", go ? "Pause" : "Play");
    cancelAnimationFrame(playing);
    playing = null;
    if (!go) return;
    if (now >= flight.end) set(0);
    let before = performance.now();
    const step = at => {
      set(now + (at - before) / 1000 * Number(bar.querySelector("select").value));
      before = at;
      if (now >= flight.end) play(false); else playing = requestAnimationFrame(step);
    };
    playing = requestAnimationFrame(step);
  }
  if (flight) {
    bar.hidden = false;
    document.body.classList.add("scrubbed");
    bar.querySelector("input").addEventListener("input", event => { play(false); set(Number(event.target.value)); });
    bar.querySelector("button.play").addEventListener("click", () => play(playing === null));
    for (const one of document.querySelectorAll("[data-t]")) {
      const go = () => { play(false); set(Number(one.dataset.t)); };
      one.addEventListener("click", go);
      one.addEventListener("keydown", event => { if (event.key === "Enter") go(); });
    }
    const asked = /t=([\d.]+)/.exec(location.hash);
    set(asked ? Number(asked[1]) : flight.first);
  }
  addEventListener("scroll", near, { passive: true });
  near();
})();
