"use strict";
(() => {
const data = JSON.parse(document.getElementById("explore-data").textContent);
const at = id => document.getElementById(id);
const labels = ["declared model", "adopted law"];
const box = {width: 460, height: 300, left: 62, right: 12, top: 10, bottom: 40};

function put(parent, name, attributes, text) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const key in attributes) node.setAttribute(key, attributes[key]);
  if (text !== undefined) node.textContent = text;
  parent.append(node);
  return node;
}
const known = values => values.filter(v => v !== null);
function range(lists) {
  const all = lists.flatMap(known);
  let low = Math.min(...all), high = Math.max(...all);
  if (!(high > low)) { const room = Math.abs(high) * 1e-3 || 1; low -= room; high += room; }
  const edge = 0.05 * (high - low);
  return [low - edge, high + edge];
}
function steps([low, high]) {
  const rough = (high - low) / 4, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(k => k * power).find(k => k >= rough);
  const out = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) out.push(+(k * step).toPrecision(6));
  return out;
}
function square(x, y) {
  const w = box.width - box.left - box.right, h = box.height - box.top - box.bottom;
  const scale = Math.max((x[1] - x[0]) / w, (y[1] - y[0]) / h);
  const grow = (r, size) => { const m = (r[0] + r[1]) / 2; return [m - scale * size / 2, m + scale * size / 2]; };
  return [grow(x, w), grow(y, h)];
}
function frame(svg, x, y, xName, yName) {
  svg.replaceChildren();
  const px = v => box.left + (v - x[0]) / (x[1] - x[0]) * (box.width - box.left - box.right);
  const py = v => box.height - box.bottom - (v - y[0]) / (y[1] - y[0]) * (box.height - box.top - box.bottom);
  const text = {"font-size": 11, fill: "#222"};
  for (const v of steps(x)) {
    put(svg, "line", {x1: px(v), x2: px(v), y1: box.top, y2: box.height - box.bottom, stroke: "#eee"});
    put(svg, "text", {...text, x: px(v), y: box.height - box.bottom + 14, "text-anchor": "middle"}, v);
  }
  for (const v of steps(y)) {
    put(svg, "line", {x1: box.left, x2: box.width - box.right, y1: py(v), y2: py(v), stroke: "#eee"});
    put(svg, "text", {...text, x: box.left - 5, y: py(v) + 4, "text-anchor": "end"}, v);
  }
  put(svg, "text", {...text, x: (box.left + box.width) / 2, y: box.height - 6, "text-anchor": "middle"}, xName);
  const middle = (box.height - box.bottom) / 2;
  put(svg, "text", {...text, x: 12, y: middle, "text-anchor": "middle", transform: `rotate(-90 12 ${middle})`}, yName);
  return [px, py];
}
function path(svg, xs, ys, [px, py], attributes) {
  let out = "", pen = "M";
  xs.forEach((x, k) => {
    if (x === null || ys[k] === null) { pen = "M"; return; }
    out += `${pen}${px(x).toFixed(1)} ${py(ys[k]).toFixed(1)}`; pen = "L";
  });
  put(svg, "path", {d: out, fill: "none", "stroke-width": 1.6, ...attributes});
}
function dots(svg, xs, ys, [px, py], attributes) {
  xs.forEach((x, k) => {
    if (x !== null && ys[k] !== null) put(svg, "circle", {cx: px(x).toFixed(1), cy: py(ys[k]).toFixed(1), ...attributes});
  });
}
const named = (name, unit) => unit ? `${name} (${unit})` : name;
const shown = k => { const toggle = at(`explore-${k ? "after" : "before"}`); return !toggle || toggle.checked; };

function drawTrack() {
  const track = data.tracks[at("explore-track").value], row = +at("explore-time").value;
  const isPath = track.axes.length === 2;
  const pair = p => isPath ? p : [track.t, p[0]];
  const all = [track.observed, ...track.models].map(pair);
  const seen = pair(track.observed);
  let x = range(all.map(p => p[0])), y = range(all.map(p => p[1]));
  if (isPath) [x, y] = square(x, y);
  const names = isPath ? track.axes.map(a => named(a, track.unit))
    : [named("time", track.t_unit), named(track.axes[0], track.unit)];
  const svg = at("explore-path"), to = frame(svg, x, y, ...names);
  dots(svg, ...seen, to, {r: 2, fill: "#999"});
  const dash = ["5 3", "none"];
  track.models.forEach((m, k) => shown(k) && path(svg, ...pair(m), to, {stroke: data.colours[k], "stroke-dasharray": dash[k]}));
  const now = p => [[pair(p)[0][row]], [pair(p)[1][row]]];
  track.models.forEach((m, k) => shown(k) && dots(svg, ...now(m), to, {r: 5, fill: data.colours[k]}));
  dots(svg, ...now(track.observed), to, {r: 5, fill: "none", stroke: "#222", "stroke-width": 2});
  const errors = at("explore-errors"), drawn = track.errors.filter((e, k) => shown(k));
  const on = frame(errors, range([track.t]), range(drawn.length ? [...drawn, [0]] : [[0, 1]]),
    named("time", track.t_unit), named("position error", track.error_unit));
  track.errors.forEach((e, k) => shown(k) && path(errors, track.t, e, on, {stroke: data.colours[k], "stroke-dasharray": dash[k]}));
  const when = on[0](track.t[row]);
  put(errors, "line", {x1: when, x2: when, y1: box.top, y2: box.height - box.bottom, stroke: "#222"});
  const told = track.errors.map((e, k) => e[row] === null ? "" : `${labels[k]} ${+e[row].toPrecision(3)} ${track.error_unit} off`);
  at("explore-now").textContent = `At ${+track.t[row].toPrecision(4)} ${track.t_unit}: ${told.filter(Boolean).join(", ") || "nothing was seen"}.`;
}
function pickTrack() {
  const time = at("explore-time");
  time.max = data.tracks[at("explore-track").value].t.length - 1;
  time.value = time.max;
  drawTrack();
}
function drawLeft() {
  const of = data.left.against[at("explore-against").value], size = data.left.sizes[at("explore-size").value];
  const x = range([of.values]), drawn = size.values.filter((v, k) => shown(k));
  const to = frame(at("explore-left"), x, range(drawn.length ? drawn : [[0, 1]]),
    named(of.name, of.unit), named("residual acceleration", size.unit));
  size.values.forEach((v, k) => shown(k) && dots(at("explore-left"), of.values, v, to, {r: 1.6, fill: data.colours[k], "fill-opacity": 0.45}));
}
const options = (id, names) => names.forEach((name, k) => at(id).add(new Option(name, k)));
function draw() { drawTrack(); if (data.left) drawLeft(); }
options("explore-track", data.tracks.map(t => t.name));
if (data.left) {
  options("explore-against", data.left.against.map(v => v.name));
  options("explore-size", data.left.sizes.map(v => v.name));
  for (const id of ["explore-against", "explore-size"]) at(id).addEventListener("change", drawLeft);
}
at("explore-track").addEventListener("change", pickTrack);
at("explore-time").addEventListener("input", drawTrack);
for (const id of ["explore-before", "explore-after"]) at(id)?.addEventListener("change", draw);
at("explore").hidden = false;
pickTrack();
draw();
})();
