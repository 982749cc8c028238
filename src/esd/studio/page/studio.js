// The studio's page: a project's shapes, jobs and maps around the viewer.
import { drawGallery } from "esd/gallery.js";
import { createLandmarks } from "esd/landmarks.js";
import { connectPanel, showFailure } from "esd/panel.js";
import { ask, askScene, download, droppedFiles, keepingFocus } from "esd/server.js";
import { connectTransfer } from "esd/transfer.js";
import { createViewer, hasWebGL2 } from "esd/viewer.js";

const element = (id) => document.getElementById(id);
const stage = element("stage");
const empty = element("empty");

let state = { version: -1, shapes: [], maps: [], jobs: [], settings: {}, models: [], formats: [] };
let pair = { source: 0, target: 0 }; // numbers of the shapes that are shown
let known = -1; // version of the state from which on it has all shapes that were added
let shown = ""; // what is on the stage
const dismissed = new Set(); // jobs whose failure was read

function say(line) {
  element("message").textContent = line;
  clearTimeout(say.timer);
  say.timer = setTimeout(() => { element("message").textContent = ""; }, 8000);
}

const guarded = (action) => async (...given) => {
  try {
    return await action(...given);
  } catch (error) {
    say(error.message);
    return undefined;
  }
};

// The viewer

let update = () => {};
let viewer = null;
let landmarks = null;
if (hasWebGL2()) {
  viewer = createViewer(stage, {
    change: () => { update(); keepUp(); },
    point: (picked) => { element("readout").textContent = picked ? viewer.describe(picked) : ""; },
    pick: (picked) => landmarks.pick(picked),
    drag: (pin, vertex) => landmarks.drag(pin, vertex),
    drop: (pin) => landmarks.drop(pin),
  });
  landmarks = createLandmarks(viewer, say);
  update = connectPanel(viewer, {
    keys: {
      n: () => landmarks.setAdding(!landmarks.isAdding()),
      s: () => landmarks.suggest(),
      Escape: () => { landmarks.setAdding(false); viewer.drop(); },
    },
  });
  const added = [["N, S", "add pairs of landmarks; go where the map is least sure"], ["Ctrl+Z", "undo a landmark; with Shift, redo"]];
  for (const [key, text] of added) document.querySelector("#help dl").append(made("dt", key), made("dd", text));
} else showFailure(stage);

const shapeOf = (number) => state.shapes.find((shape) => shape.number === number);
const mapOf = ({ source, target }) => state.maps.find((map) => map.source === source && map.target === target);

const drawTransfer = connectTransfer(
  () => ({ source: shapeOf(pair.source), target: shapeOf(pair.target), map: mapOf(pair), maps: state.maps }),
  guarded,
);

// The axis that the user turns up is kept with the source.
let keptUp = "";
const keepUp = guarded(async () => {
  const { up } = viewer.state;
  const source = shapeOf(pair.source);
  if (!shown || up === keptUp || !source) return;
  keptUp = up;
  await ask(`shapes/${source.number}/up`, { method: "PUT", json: { up } });
});

const showPair = guarded(async () => {
  const source = shapeOf(pair.source);
  const target = shapeOf(pair.target);
  const map = mapOf(pair);
  const ready = [source, target].filter((shape) => shape && shape.vertices !== null);
  const key = map ? `map ${pair.source} ${pair.target} ${map.stamp} ${source.labels}` : `shapes ${ready.map(({ number }) => number)}`;
  empty.hidden = ready.length > 0;
  element("empty-button").hidden = state.shapes.length > 0;
  element("empty-line").textContent = state.shapes.length ? "The meshes are being examined …" : "Drop two meshes here, or a folder of them.";
  element("export").hidden = !map;
  landmarks?.show(state.version, ...(ready.length === 2 ? ready : []));
  if (!viewer || key === shown) return;
  shown = key;
  if (!ready.length) {
    viewer.load({ meta: { up: keptUp = "y" }, arrays: {} });
    delete document.documentElement.dataset.shown;
    return;
  }
  let scene;
  try {
    scene = await (map ? matchedScene(source, target) : bareScene(ready));
  } catch (error) {
    if (shown === key) shown = ""; // the next state asks again
    throw error;
  }
  if (shown !== key) return; // something else is wanted by now
  scene.meta.up = keptUp = ready[0].up || scene.meta.up;
  viewer.mark({});
  viewer.load(scene, { keepView: true });
  document.documentElement.dataset.shown = key;
});

// A map, with the labels and the texture of the source.
async function matchedScene(source, target) {
  const [scene, labels, own] = await Promise.all([
    askScene(`maps/${source.number}/${target.number}/view`),
    source.labels ? askScene(`shapes/${source.number}/labels/view`) : null,
    source.look ? askScene(`shapes/${source.number}/view`) : null,
  ]);
  if (labels) {
    scene.meta.names = labels.meta.names;
    scene.arrays.labels = labels.arrays.labels;
  }
  if (own?.arrays.texture) scene.arrays.texture = own.arrays.texture;
  return scene;
}

// One or two shapes without a map.
async function bareScene(ready) {
  const scenes = await Promise.all(ready.map(({ number }) => askScene(`shapes/${number}/view`)));
  const [first, second] = scenes;
  if (!second) return first;
  const { source_positions: positions, source_faces: faces } = second.arrays;
  const radius = Math.max(first.meta.radius, second.meta.radius);
  return {
    meta: { ...first.meta, target: second.meta.source, radius },
    arrays: { ...first.arrays, target_positions: positions, target_faces: faces },
  };
}

// The project

function draw() {
  element("folder").textContent = `Kept in ${state.folder}`;
  const numbers = state.shapes.map(({ number }) => number);
  if (state.version >= known) { // an older state may lack the pair that was just added
    if (!numbers.includes(pair.source)) pair.source = numbers[0] ?? 0;
    if (!numbers.includes(pair.target) || pair.target === pair.source) pair.target = numbers.find((n) => n !== pair.source) ?? 0;
  }
  for (const side of ["source", "target"]) {
    fill(element(side), state.shapes.map(({ number, name }) => [String(number), name]), String(pair[side]));
  }
  fill(element("model"), state.models.map((name) => [name, name]), state.settings.model);
  element("mirror").value = state.settings.mirror;
  element("start").disabled = state.shapes.length < 2;
  element("swap").disabled = state.shapes.length < 2;
  redrawn("shapes", () => element("shapes").replaceChildren(...state.shapes.map(drawnShape)));
  redrawn("jobs", drawJobs);
  element("gallery").hidden = state.shapes.length < 3;
  redrawn("maps", () => drawGallery(element("maps"), state, pair, choose));
  drawTransfer();
  return showPair();
}

function redrawn(id, action) {
  keepingFocus(element(id), action);
}

function fill(select, choices, value) {
  const text = JSON.stringify(choices);
  if (select.dataset.choices !== text) {
    select.dataset.choices = text;
    select.replaceChildren(...choices.map(([key, name]) => Object.assign(document.createElement("option"), { value: key, textContent: name })));
  }
  select.value = value;
}

function made(tag, text, attributes = {}) {
  return Object.assign(document.createElement(tag), { textContent: text ?? "" }, attributes);
}

const opened = new Set(); // shapes whose findings are unfolded

function drawnShape(shape) {
  const item = made("li", shape.name);
  if (shape.vertices === null) item.append(made("small", "being examined …"));
  else item.append(made("small", `${shape.vertices.toLocaleString("en")} vertices, ${shape.faces.toLocaleString("en")} faces`));
  if (shape.findings.length) item.append(drawnFindings(shape));
  const remove = made("button", "Remove", { type: "button" });
  remove.setAttribute("aria-label", `Remove ${shape.name}`);
  remove.addEventListener("click", guarded(async () => {
    const lost = [[shape.names.length, "landmarks"], [state.maps.filter((map) => [map.source, map.target].includes(shape.number)).length, "maps"]];
    const named = lost.filter(([count]) => count).map(([, name]) => name);
    if (named.length && !confirm(`Remove ${shape.name} with its ${named.join(" and ")}?`)) return;
    await ask(`shapes/${shape.number}`, { method: "DELETE" });
  }));
  const buttons = made("span", "", { className: "buttons" });
  if (shape.findings.length) {
    const repair = made("button", "Repair", { type: "button", title: "Adds a repaired copy" });
    repair.setAttribute("aria-label", `Repair ${shape.name}`);
    repair.addEventListener("click", guarded(() => ask(`shapes/${shape.number}/repair`, { method: "POST" })));
    buttons.append(repair);
  }
  buttons.append(remove);
  item.append(buttons);
  return item;
}

function drawnFindings(shape) {
  const details = made("details");
  details.open = opened.has(shape.number);
  details.addEventListener("toggle", () => (details.open ? opened.add(shape.number) : opened.delete(shape.number)));
  const list = made("ul");
  for (const finding of shape.findings) {
    const item = made("li");
    const text = made("span", finding.what, { title: `${finding.effect} Remedy: ${finding.remedy}.` });
    text.dataset.severity = finding.severity;
    item.append(text);
    if (finding.marked.length && viewer) {
      const where = made("button", "Show", { type: "button" });
      where.setAttribute("aria-label", `Show where: ${finding.what}`);
      where.addEventListener("click", async () => {
        if (![pair.source, pair.target].includes(shape.number)) await choose(shape.number, pair.target);
        const side = pair.source === shape.number ? "source" : "target";
        viewer.mark({ [side]: finding.marked });
        viewer.flyTo(side, finding.marked[0]);
      });
      item.append(" ", where);
    }
    list.append(item);
  }
  details.append(made("summary", `${shape.findings.length} finding${shape.findings.length > 1 ? "s" : ""}`), list);
  return details;
}

function drawJobs() {
  const listed = state.jobs.filter((job) => ["waiting", "running"].includes(job.state) || (job.state === "failed" && !dismissed.has(job.number)));
  element("jobs").replaceChildren(
    ...listed.map((job) => {
      const item = made("li", undefined, { className: job.state });
      const text = made("span", job.title);
      text.append(made("small", job.error || job.stage || "waiting"));
      if (job.state === "running") {
        // an undetermined bar would be animated, and without a GPU each of its pictures costs
        const bar = Object.assign(document.createElement("progress"), { value: job.share });
        bar.setAttribute("aria-label", job.title);
        text.append(bar);
      }
      const button = made("button", job.state === "failed" ? "Dismiss" : "Cancel", { type: "button" });
      button.setAttribute("aria-label", `${button.textContent}: ${job.title}`);
      button.addEventListener("click", guarded(async () => {
        if (job.state !== "failed") await ask(`jobs/${job.number}`, { method: "DELETE" });
        dismissed.add(job.number);
        drawJobs();
      }));
      item.append(text, button);
      return item;
    }),
  );
}

function choose(source, target) {
  pair = { source, target };
  return draw();
}

const match = guarded(async (withLandmarks, { source, target } = pair) => {
  await landmarks?.saved();
  await ask("matches", { method: "POST", json: { source, target, landmarks: withLandmarks } });
});

const isMesh = ({ name }) => state.formats.some((suffix) => [suffix, `${suffix}.gz`].some((end) => name.toLowerCase().endsWith(end)));

const addFiles = guarded(async (files) => {
  const numbers = [];
  const others = files.filter((file) => !isMesh(file)).map(({ name }) => name);
  if (others.length) say(`Left out, since not a mesh: ${others.slice(0, 5).join(", ")}${others.length > 5 ? ", …" : ""}.`);
  for (const file of files.filter(isMesh)) {
    const added = await guarded(() => ask(`shapes?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file }))();
    if (added) {
      numbers.push(added.number);
      known = Math.max(known, added.version);
    }
  }
  if (numbers.length === 2) {
    pair = { source: numbers[0], target: numbers[1] };
    await match(false);
  }
});

async function follow() {
  for (let pause = 0; ; ) {
    try {
      state = await ask(`state?after=${state.version}`);
      pause = 0;
      draw();
      document.documentElement.dataset.following = "true";
    } catch (error) {
      say(error.message);
      pause = 2000;
    }
    if (pause) await new Promise((done) => setTimeout(done, pause));
  }
}

// What is clicked and dropped

const listen = (id, kind, action) => element(id).addEventListener(kind, action);
for (const id of ["add", "add-too"]) listen(id, "click", () => element("files").click());
listen("files", "change", (event) => {
  const files = [...event.target.files];
  event.target.value = "";
  addFiles(files);
});
listen("match", "submit", (event) => {
  event.preventDefault();
  match(false);
});
listen("rematch", "click", () => match(true));
listen("swap", "click", () => choose(pair.target, pair.source));
for (const side of ["source", "target"]) {
  listen(side, "change", (event) => {
    const number = Number(event.target.value);
    const other = side === "source" ? "target" : "source";
    choose(...(pair[other] === number ? [pair.target, pair.source] : side === "source" ? [number, pair.target] : [pair.source, number]));
  });
}
for (const id of ["model", "mirror"]) {
  listen(id, "change", guarded(() => ask("settings", { method: "PUT", json: { model: element("model").value, mirror: element("mirror").value } })));
}
listen("match-all", "click", guarded(async () => {
  const { shapes } = state;
  for (const [k, first] of shapes.entries()) {
    for (const second of shapes.slice(k + 1)) {
      const some = { source: first.number, target: second.number };
      if (!mapOf(some)) await match(false, some);
    }
  }
}));
listen("carry", "click", guarded(() => ask(`maps/${pair.source}/${pair.target}/landmarks`, { method: "POST" })));
for (const kind of ["map", "mesh"]) {
  listen(`export-${kind}`, "click", () => download(`maps/${pair.source}/${pair.target}/${kind}?format=${element(`${kind}-format`).value}`));
}
listen("export-page", "click", () => download(`maps/${pair.source}/${pair.target}/page`));
listen("export-picture", "click", guarded(async () => {
  const address = URL.createObjectURL(await viewer.picture());
  download(address, "map.png");
  setTimeout(() => URL.revokeObjectURL(address), 10000);
}));
window.addEventListener("dragover", (event) => {
  event.preventDefault();
  stage.classList.add("dropping");
});
window.addEventListener("dragleave", () => stage.classList.remove("dropping"));
window.addEventListener("drop", guarded(async (event) => {
  event.preventDefault();
  stage.classList.remove("dropping");
  const files = await droppedFiles(event.dataTransfer);
  addFiles(files.filter(({ name }) => !name.startsWith(".")));
}));

follow();
