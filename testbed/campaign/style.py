"""Style and script of a page, light and dark, without external resources."""

STYLE = """
:root { color-scheme: light dark;
  --paper: #fbfaf7; --card: #ffffff; --ink: #1d2530; --soft: #5b6775; --line: #e3e1da;
  --good: #1f7a8c; --bad: #d1495b; --front: #b07d12; --shade: 0 1px 2px #1d253014;
  --h0: #0069b4; --h1: #d95f02; --h2: #00876c; --h3: #b0479a; --h4: #7a6a00; --h5: #4b4fa8; }
@media screen and (prefers-color-scheme: dark) { :root {
  --paper: #12161c; --card: #1a2028; --ink: #e8e6e1; --soft: #98a3b0; --line: #2b333e;
  --good: #4db6c6; --bad: #ff7a86; --front: #f0b840; --shade: none;
  --h0: #58a6ff; --h1: #ff9f4a; --h2: #3ccfae; --h3: #e58ad4; --h4: #d8c64a; --h5: #9fa4ff; } }
.c0 { --hue: var(--h0); } .c1 { --hue: var(--h1); } .c2 { --hue: var(--h2); }
.c3 { --hue: var(--h3); } .c4 { --hue: var(--h4); } .c5 { --hue: var(--h5); }
.rest { --hue: var(--soft); }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 15px/1.5 ui-sans-serif, system-ui, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
main { max-width: 1380px; margin: 0 auto; padding: 36px 28px 64px; }
h1 { font-size: 30px; line-height: 1.15; letter-spacing: -0.015em; margin: 0 0 4px; }
h2 { font-size: 17px; margin: 40px 0 4px; letter-spacing: -0.005em; }
p { margin: 0 0 12px; max-width: 78ch; } .soft { color: var(--soft); }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(180px, 1fr)); gap: 14px;
  margin: 22px 0 8px; }
.tile, figure, .card { background: var(--card); border: 1px solid var(--line); border-radius: 10px;
  box-shadow: var(--shade); }
.tile { padding: 14px 18px 12px; } .tile b { display: block; font-size: 27px; line-height: 1.2;
  font-weight: 650; font-variant-numeric: tabular-nums; letter-spacing: -0.02em; }
.tile span { color: var(--soft); font-size: 13px; } .tile.main b { color: var(--good); }
.tile.main.poor b { color: var(--bad); }
.meter { position: relative; height: 6px; border-radius: 3px; background: var(--line);
  margin: 9px 0 6px; }
.meter i { position: absolute; top: 0; bottom: 0; border-radius: 3px; background: var(--good);
  opacity: .35; min-width: 3px; }
.meter u { position: absolute; top: -3px; width: 3px; height: 12px; border-radius: 2px;
  background: var(--good); }
.poor .meter i, .poor .meter u { background: var(--bad); }
.charts { display: grid; gap: 14px;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 390px), 1fr)); }
figure { margin: 0; padding: 10px 12px 8px; } svg { display: block; width: 100%; height: auto; }
figcaption { color: var(--soft); font-size: 12.5px; padding: 0 6px 4px; }
.tick { font-size: 10.5px; fill: var(--soft); font-variant-numeric: tabular-nums; }
.label, .row { font-size: 11.5px; fill: var(--ink); }
.grid { stroke: var(--line); stroke-width: 1; fill: none; }
.axis { stroke: var(--soft); stroke-width: 1; fill: none; }
.good { fill: var(--good); } circle.good { fill-opacity: .62; } .bad { fill: var(--bad); }
.bad-mark { stroke: var(--bad); stroke-width: 1.7; stroke-linecap: round; fill: none; }
.front { fill: none; stroke: var(--hue, var(--front)); stroke-width: 1.8; stroke-linejoin: round; }
.front-mark { fill: var(--card); stroke: var(--front); stroke-width: 2; }
.case { fill: var(--hue, var(--soft)); fill-opacity: .72; stroke: var(--hue, var(--soft)); }
.case.open { fill: var(--card); fill-opacity: .35; stroke-width: 1.5; }
.case.front-mark { fill: var(--hue); fill-opacity: 1; stroke: var(--ink); stroke-width: 1.3; }
.case.solid { fill-opacity: 1; } .median { stroke: var(--ink); stroke-width: 1.8; fill: none; }
.whisker { stroke: var(--hue, var(--good)); stroke-width: 2.5; stroke-linecap: round;
  opacity: .45; }
.heat { fill: color-mix(in oklab, var(--good) calc(8% + 92% * var(--share)), var(--card)); }
.on-heat { font-size: 10.5px; fill: var(--ink); font-variant-numeric: tabular-nums; }
.on-heat.dark { fill: var(--card); }
.key { display: inline-flex; gap: 6px; align-items: center; margin-right: 14px; font-size: 13px;
  color: var(--soft); } .key svg { width: 12px; height: 12px; display: inline-block; }
.swatch { width: 12px; height: 12px; display: inline-block; margin-right: 7px;
  vertical-align: -1px; } td.name { min-width: 150px; }
.charts + .charts { margin-top: 14px; }
h3 { font-size: 13.5px; font-weight: 600; margin: 18px 0 8px; }
.card { overflow-x: auto; } table { border-collapse: collapse; width: 100%; font-size: 13.5px; }
th, td { text-align: left; padding: 7px 14px; border-bottom: 1px solid var(--line);
  vertical-align: top; } tr:last-child td { border-bottom: 0; }
th { font-weight: 600; color: var(--soft); font-size: 12.5px; white-space: nowrap; }
td.n, th.n { text-align: right; width: 1%; white-space: nowrap;
  font-variant-numeric: tabular-nums; }
.passed { color: var(--good); } .failed, .fault, .error, .refused, .lost { color: var(--bad); }
code { font: 12px/1.45 ui-monospace, "SF Mono", Menlo, Consolas, monospace; }
td code { display: block; overflow-wrap: anywhere; } td.wide { width: 52%; min-width: 320px; }
button { font: inherit; font-size: 12px; color: var(--soft); background: none; cursor: pointer;
  border: 1px solid var(--line); border-radius: 6px; padding: 1px 8px; margin-top: 4px; }
button:hover { color: var(--ink); border-color: var(--soft); }
@media (max-width: 640px) { main { padding: 22px 14px 48px; } td.wide { min-width: 220px; }
  .tiles { grid-template-columns: 1fr 1fr; } th, td { padding: 6px 8px; } .tick { font-size: 12px; }
  .label { font-size: 13px; } }
@media print { main { padding: 0; } button { display: none; } figure { break-inside: avoid; } }
"""

SCRIPT = """
document.addEventListener("click", (event) => {
  const button = event.target.closest("button");
  if (!button) return;
  const words = button.previousElementSibling.textContent;
  navigator.clipboard?.writeText(words).then(() => {
    button.textContent = "copied";
    setTimeout(() => { button.textContent = "copy"; }, 1200);
  });
});
"""
