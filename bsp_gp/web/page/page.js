"use strict";
// Everything a user's file says reaches the page through textContent, never as HTML.

const KNOWN = [
  ["weight", "9.81 [m/s^2] * m_i * down"],
  ["weight, g to be found", "g * m_i * down"],
  ["air, slow: drag linear in speed", "-c * v_i"],
  ["air, fast: drag quadratic in speed", "-c * norm(v_i) * v_i"],
  ["sliding friction", "-mu * m_i * normalize(v_i)"],
  ["spring to a body of the data", "k * (norm(p_i - p_j) - l_j) * normalize(p_j - p_i)"],
  ["spring, rest length to be found", "k * (norm(p_i - p_j) - L) * normalize(p_j - p_i)"],
  ["gravity between bodies", "6.6743e-11 [m^3/kg/s^2] * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"],
  ["attraction, strength to be found", "G * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"],
  ["charges", "K * q_i * q_j / norm(p_i - p_j)^2 * normalize(p_i - p_j)"],
  ["magnetic field across the plane", "B * q_i * perp(v_i)"],
  ["constant push along x", "F * e_x"],
  ["rod or taut string to a point", "norm(p_i - (a, b)) = L"],
  ["incline", "y_i = a * x_i"],
  ["the camera or the table turns", "rotating(Omega)"],
];
const MEANINGS = ["", "t", "frame", "x", "y", "z", "entity", "scene", "sx", "sy", "sz", "vx", "vy", "vz",
  "mass", "charge", "radius", "distance", "angle"];
const WORDS = { "": "as understood", t: "time (t)", frame: "number of a frame", x: "position x", y: "position y",
  z: "position z", entity: "which body", scene: "which recording", sx: "error of x", sy: "error of y",
  sz: "error of z", vx: "velocity x", vy: "velocity y", vz: "velocity z" };
const UNITS = ["", "m", "cm", "mm", "km", "in", "ft", "px", "s", "ms", "min", "h", "kg", "g", "deg", "rad",
  "m/s", "cm/s", "N", "C", "1"];
const at = (node, selector) => node.querySelector(selector);
const sleep = ms => new Promise(done => setTimeout(done, ms));

async function ask(address, body, method = "POST") {
  const options = method === "GET" ? {} :
    { method, body: method === "PUT" ? body : JSON.stringify(body || {}) };
  let answer;
  try { answer = await fetch(address, options); }
  catch { throw new Error("bsp-gp serve does not answer: was it ended in the terminal?"); }
  let found = {};
  try { found = await answer.json(); } catch { /* no JSON: the status says it */ }
  if (!answer.ok) throw new Error(found.error || `the server answered ${answer.status}`);
  return found;
}

function say(text, isBad = false) {
  const message = document.getElementById("message");
  message.textContent = text;
  message.classList.toggle("bad", isBad);
}

// --- dropping --------------------------------------------------------------------------------------

async function entriesOf(entry, path = "") {
  if (entry.isFile) {
    const file = await new Promise((done, fail) => entry.file(done, fail));
    return [[path + entry.name, file]];
  }
  const reader = entry.createReader(), out = [];
  for (;;) {
    const batch = await new Promise((done, fail) => reader.readEntries(done, fail));
    if (!batch.length) return out;
    for (const each of batch) out.push(...await entriesOf(each, `${path}${entry.name}/`));
  }
}

async function take(files) {
  if (!files.length) return;
  const total = files.reduce((sum, [, file]) => sum + file.size, 0);
  say(`Taking ${files.length === 1 ? files[0][0] : `${files.length} files`}, ${(total / 1e6).toFixed(1)} MB …`);
  try {
    const { key } = await ask("data");
    for (const [name, file] of files)
      await ask(`data/${key}/files/${name.split("/").map(encodeURIComponent).join("/")}`, file, "PUT");
    say("");
    new Card(key, files.length === 1 ? files[0][0] : files[0][0].split("/")[0]);
  } catch (error) { say(error.message, true); }
}

const drop = document.getElementById("drop");
for (const name of ["dragenter", "dragover"])
  document.addEventListener(name, event => { event.preventDefault(); drop.classList.add("over"); });
document.addEventListener("dragleave", event => { if (!event.relatedTarget) drop.classList.remove("over"); });
document.addEventListener("drop", async event => {
  event.preventDefault();
  drop.classList.remove("over");
  const entries = [...event.dataTransfer.items].map(item => item.webkitGetAsEntry && item.webkitGetAsEntry());
  const plain = [...event.dataTransfer.files].map(file => [file.name, file]);
  const found = [];
  for (const entry of entries.filter(Boolean)) found.push(...await entriesOf(entry));
  take(found.length ? found : plain);
});
for (const id of ["file", "folder"])
  document.getElementById(id).addEventListener("change", event => {
    take([...event.target.files].map(file => [file.webkitRelativePath || file.name, file]));
    event.target.value = "";
  });

// --- one data set ----------------------------------------------------------------------------------

class Card {
  constructor(key, name) {
    this.key = key;
    this.node = document.getElementById("card").content.firstElementChild.cloneNode(true);
    at(this.node, "h2").textContent = name;
    document.getElementById("cards").prepend(this.node);
    this.node.scrollIntoView();
    this.columns = [];
    this.turn = 0;
    const known = at(this.node, ".known");
    known.append(new Option("from a list …", ""), ...KNOWN.map(([label, law]) => new Option(label, law)));
    known.addEventListener("change", () => {
      if (known.value) this.addLaw(known.value, known.selectedOptions[0].text);
      known.value = "";
    });
    at(this.node, ".own").addEventListener("click", () => this.addLaw("", "typed"));
    at(this.node, ".run").addEventListener("click", () => this.run());
    for (const name of [".up", ".fps"]) at(this.node, name).addEventListener("change", () => this.check());
    at(this.node, ".follow").addEventListener("click", () => this.follow());
    this.check();
  }

  error(text) {
    const node = at(this.node, ":scope > .error");
    node.textContent = text;
    node.hidden = !text;
  }

  options() {
    const columns = {}, units = {};
    for (const { theirs, meaning, unit, was } of this.columns) {
      if (meaning.value) columns[meaning.value] = theirs;
      if (unit.value && unit.value !== was) units[meaning.value || meaning.dataset.ours || theirs] = unit.value;
    }
    return { columns, units, up: at(this.node, ".up").value, fps: at(this.node, ".fps").value };
  }

  async check() {
    const turn = ++this.turn, status = at(this.node, ".checking");
    at(this.node, ".understood").hidden = false;
    status.textContent = "Looking at it …";
    this.error("");
    let answer;
    try { answer = await ask(`data/${this.key}/check`, this.options()); }
    catch (error) {
      if (turn === this.turn) { status.textContent = ""; this.error(error.message); this.ready(false); }
      return;
    }
    if (turn !== this.turn || answer.is_late) return;  // another look is under way
    status.textContent = "";
    if (answer.is_film) this.film(answer.glimpse);
    else if (!this.columns.length && Array.isArray(answer.glimpse)) this.table(answer.glimpse);
    if (answer.text === undefined) { at(this.node, ".understood").hidden = true; return; }
    at(this.node, ".text").textContent = answer.text;
    this.error(answer.error);
    const picture = at(this.node, ".picture");
    picture.hidden = Boolean(answer.error);
    if (!answer.error) picture.src = `data/${this.key}/check.png?${turn}`;
    this.ready(!answer.error);
  }

  ready(isReady) {
    const declare = at(this.node, ".declare");
    this.isReady = isReady;
    if (isReady) {
      declare.hidden = false;
      this.checkLaws();
    }
    this.mayRun();
  }

  table(columns) {
    const table = at(this.node, ".columns");
    table.hidden = !columns.length;
    const cell = (row, text, tag = "td") => {
      const node = document.createElement(tag);
      if (tag === "th") node.scope = "col";
      node.textContent = text;
      return row.appendChild(node);
    };
    const head = at(table, "thead"), body = at(table, "tbody");
    const names = head.insertRow(), meanings = head.insertRow(), units = head.insertRow();
    for (const { theirs, ours, unit } of columns) {
      cell(names, theirs, "th");
      const meaning = document.createElement("select"), chosen = document.createElement("select");
      meaning.setAttribute("aria-label", `Meaning of ${theirs}`);
      chosen.setAttribute("aria-label", `Unit of ${theirs}`);
      for (const word of MEANINGS) {
        const label = WORDS[word] || word;
        meaning.append(new Option(word || !ours ? label : `${WORDS[ours] || ours}, as understood`, word));
      }
      meaning.dataset.ours = ours;
      for (const word of new Set([unit, ...UNITS])) chosen.append(new Option(word || "unit?", word));
      chosen.value = unit;
      for (const node of [meaning, chosen]) node.addEventListener("change", () => this.check());
      cell(meanings, "").append(meaning);
      cell(units, "").append(chosen);
      this.columns.push({ theirs, meaning, unit: chosen, was: unit });
    }
    for (let k = 0; k < (columns.length ? columns[0].rows.length : 0); k++) {
      const row = body.insertRow();
      for (const { rows } of columns) cell(row, rows[k]);
    }
  }

  // --- films ---

  film(about) {
    if (this.frame || !about) return;
    const section = at(this.node, ".film"), canvas = at(section, "canvas"), image = new Image();
    section.hidden = false;
    this.frame = image;
    this.points = [];
    this.hasColour = false;
    at(section, ".rate").value = Number(about.fps.toFixed(3));
    const draw = () => {
      const pen = canvas.getContext("2d", { willReadFrequently: true });
      pen.drawImage(image, 0, 0);
      pen.strokeStyle = "#e69f00"; pen.lineWidth = 2;
      for (const [x, y] of this.points) { pen.beginPath(); pen.arc(x, y, 6, 0, 7); pen.stroke(); }
      if (this.points.length === 2) {
        pen.beginPath(); pen.moveTo(...this.points[0]); pen.lineTo(...this.points[1]); pen.stroke();
      }
    };
    image.onload = () => { canvas.width = about.width; canvas.height = about.height; draw(); };
    image.src = `data/${this.key}/frame.png`;
    canvas.addEventListener("click", event => {
      const box = canvas.getBoundingClientRect(), zoom = canvas.width / box.width;
      const x = (event.clientX - box.left) * zoom, y = (event.clientY - box.top) * zoom;
      if (!this.hasColour) {
        draw();
        const [r, g, b] = canvas.getContext("2d").getImageData(x, y, 1, 1).data;
        at(section, ".colour").value = "#" + [r, g, b].map(v => v.toString(16).padStart(2, "0")).join("");
        this.hasColour = true;
        at(section, ".progress").textContent = "Now click on two points whose distance you know.";
      } else {
        this.points = this.points.length === 2 ? [[x, y]] : [...this.points, [x, y]];
        draw();
      }
    });
    at(section, ".colour").addEventListener("change", () => { this.hasColour = true; });
  }

  async follow() {
    const section = at(this.node, ".film"), status = at(section, ".progress");
    const [a, b] = this.points.length === 2 ? this.points : [[0, 0], [0, 0]];
    const metres = Number(at(section, ".distance").value.replace(",", "."));
    const pixels = Math.hypot(a[0] - b[0], a[1] - b[1]);
    this.error("");
    const body = { name: at(section, ".name").value, colour: this.hasColour ? at(section, ".colour").value : "",
      scale: metres > 0 && pixels ? pixels / metres : "", fps: at(section, ".rate").value };
    try {
      let job = await ask(`data/${this.key}/track`, body);
      while (["waiting", "running"].includes(job.state)) {
        status.textContent = `${job.state}, ${Math.round(job.seconds)} s ${job.stage}`;
        await sleep(500);
        job = await ask(`jobs/${job.key}`, null, "GET");
      }
      status.textContent = job.state === "done" ? job.told.split("\n")[0] : "";
      if (job.state !== "done") throw new Error(job.told);
      this.check();
    } catch (error) { status.textContent = ""; this.error(error.message); }
  }

  // --- laws and runs ---

  addLaw(text, label) {
    const node = document.getElementById("law").content.firstElementChild.cloneNode(true);
    const input = at(node, ".formula");
    at(node, ".label").textContent = label;
    input.value = text;
    let timer = 0;
    input.addEventListener("input", () => {
      clearTimeout(timer);
      this.fits = false; this.mayRun();
      timer = setTimeout(() => this.checkLaws(), 200);
    });
    at(node, ".remove").addEventListener("click", () => { node.remove(); this.checkLaws(); });
    at(this.node, ".laws").append(node);
    if (!text) input.focus();
    this.checkLaws();
  }

  lawNodes() { return [...this.node.querySelectorAll(".law")].filter(node => at(node, ".formula").value.trim()); }

  async checkLaws() {
    const nodes = this.lawNodes(), laws = nodes.map(node => at(node, ".formula").value);
    const turn = this.lawTurn = (this.lawTurn || 0) + 1;
    this.fits = false; this.mayRun();
    try {
      const answer = laws.length ? await ask(`data/${this.key}/laws`, { ...this.options(), laws }) : { laws: [] };
      if (turn !== this.lawTurn) return;
      answer.laws.forEach(({ error, constants }, k) => {
        const verdict = at(nodes[k], ".verdict");
        verdict.textContent = error || (constants.length ? `to be found: ${constants.join(", ")}` : "a force, nothing to be found");
        verdict.classList.toggle("bad", Boolean(error));
      });
      this.fits = answer.laws.every(law => !law.error);
    } catch (error) { this.error(error.message); }
    this.mayRun();
  }

  mayRun() { at(this.node, ".run").disabled = !(this.isReady && this.fits); }

  async run() {
    const laws = this.lawNodes().map(node => at(node, ".formula").value);
    this.error("");
    try {
      const job = await ask(`data/${this.key}/run`,
        { ...this.options(), laws, time_limit: at(this.node, ".limit").value });
      this.watch(job);
    } catch (error) { this.error(error.message); }
  }

  async watch(job) {
    const node = document.getElementById("running").content.firstElementChild.cloneNode(true);
    at(this.node, ".runs").prepend(node);
    at(node, "h3").textContent = `Run on ${job.name}`;
    at(node, "code").textContent = job.command;
    at(node, ".stop").addEventListener("click", () => ask(`jobs/${job.key}/stop`).catch(() => {}));
    const status = at(node, ".progress");
    try {
      while (["waiting", "running"].includes(job.state)) {
        status.textContent = job.state === "waiting" ? "waiting for the run before it" :
          `${Math.round(job.seconds)} s: ${job.stage || "starting"}`;
        await sleep(500);
        job = await ask(`jobs/${job.key}`, null, "GET");
      }
    } catch (error) { status.textContent = error.message; return; }
    at(node, ".stop").hidden = true;
    status.textContent = { done: `done in ${Math.round(job.seconds)} s`, stopped: "stopped",
      failed: "could not be done" }[job.state];
    const told = at(node, ".told");
    told.textContent = job.told.replace(/\n?Report: .*$/, "");
    told.hidden = !told.textContent;
    if (job.state !== "done") return;
    at(node, ".links").hidden = false;
    at(node, ".open").href = `jobs/${job.key}/report/report.html`;
    at(node, ".download").href = `jobs/${job.key}/report.zip`;
    const frame = at(node, "iframe");
    frame.hidden = false;
    frame.src = `jobs/${job.key}/report/report.html`;
  }
}
