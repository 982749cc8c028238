// Landmarks of the pair that is shown: click, drag, name, undo, suggest, load and save.
import { ask, download, keepingFocus } from "esd/server.js";

const element = (id) => document.getElementById(id);
const COLOURS = ["#d81b60", "#1e88e5", "#ffc107", "#00897b", "#8e24aa", "#f4511e", "#7cb342", "#6d4c41"];
const APART = 0.15; // in √area: a place nearer to a landmark is not suggested

// `say` shows a line; `isMatchable` says whether the pair can be matched now.
export function createLandmarks(viewer, say) {
  let pair = null; // two shapes as the server describes them
  let rows = []; // name and vertex on either side, -1 for none
  let adding = false;
  let pending = { source: -1, target: -1 };
  let selected = -1;
  let undone = [];
  let past = [];
  let before = null; // what the rows were when a drag began
  let saving = Promise.resolve();
  let inFlight = 0;
  let known = -1; // version of the server's state from which on it has all that was saved

  const copy = () => rows.map((row) => ({ ...row }));

  function listOf(side) {
    const kept = rows.filter((row) => row[side] >= 0);
    return { names: kept.map(({ name }) => name), places: kept.map((row) => row[side]) };
  }

  // Take over what the server has, unless something is on its way to it or it is older than that.
  function show(version, source, target) {
    const isNew = pair?.source.number !== source?.number || pair?.target.number !== target?.number;
    pair = source && target ? { source, target } : null;
    element("landmarks").hidden = !pair;
    if (!pair || ((inFlight || version < known) && !isNew)) return;
    if (isNew) {
      past = [];
      undone = [];
      pending = { source: -1, target: -1 };
      selected = -1;
    }
    const names = [...new Set([...source.names, ...target.names])];
    const at = (shape, name) => shape.places[shape.names.indexOf(name)] ?? -1;
    const found = names.map((name) => ({ name, source: at(source, name), target: at(target, name) }));
    if (!isNew && JSON.stringify(found) === JSON.stringify(rows)) return;
    if (!isNew) past.push(copy());
    rows = found;
    draw();
  }

  function change(action) {
    past.push(copy());
    undone = [];
    action();
    save();
  }

  function save() {
    draw();
    const { source, target } = pair;
    const sent = [[source, listOf("source")], [target, listOf("target")]];
    inFlight++;
    saving = saving
      .then(() => Promise.all(sent.map(([shape, json]) => ask(`shapes/${shape.number}/landmarks`, { method: "PUT", json }))))
      .then((answers) => { known = Math.max(known, ...answers.map(({ version }) => version)); })
      .catch((error) => say(error.message))
      .finally(() => inFlight--);
    return saving;
  }

  function step(from, to) {
    if (!from.length) return;
    to.push(copy());
    rows = from.pop();
    selected = -1;
    save();
  }

  const undo = () => step(past, undone);
  const redo = () => step(undone, past);

  function freeName() {
    let number = rows.length + 1;
    while (rows.some(({ name }) => name === String(number))) number++;
    return String(number);
  }

  function setAdding(on) {
    adding = on;
    pending = { source: -1, target: -1 };
    draw();
  }

  // A click; whether it was for a landmark.
  function pick(picked) {
    if (!adding || !pair) return false;
    if (!picked) return true;
    pending[picked.side] = picked.vertex;
    if (pending.source >= 0 && pending.target >= 0) {
      const made = { name: freeName(), ...pending };
      pending = { source: -1, target: -1 };
      change(() => { rows.push(made); selected = rows.length - 1; });
    } else draw();
    return true;
  }

  function drag(pin, vertex) {
    before ??= copy();
    if (pin.row < 0) pending[pin.side] = vertex;
    else rows[pin.row][pin.side] = vertex;
    drawPins();
  }

  function drop(pin) {
    if (pin.row >= 0) selected = pin.row;
    if (before && pin.row >= 0) {
      past.push(before);
      undone = [];
      save();
    } else draw();
    before = null;
  }

  // Fly to the place where the map is least sure and no landmark is near.
  function suggest() {
    if (!viewer.state.hasMap) {
      say("Match the shapes first, or add pairs where you know them.");
      return;
    }
    const { meta, arrays } = viewer.scene();
    const at = (i) => [0, 1, 2].map((k) => arrays.source_positions[3 * i + k]);
    const away = (a, b) => Math.hypot(...at(a).map((x, k) => x - at(b)[k]));
    const isFree = (vertex) => rows.every(({ source }) => source < 0 || away(source, vertex) > APART);
    const place = (meta.places ?? []).find(({ vertex }) => isFree(vertex)) ?? firstFree(arrays, isFree);
    if (place === null) {
      say("No place is left to suggest.");
      return;
    }
    setAdding(true);
    pending.source = place.vertex;
    viewer.fly(place.vertex);
    draw();
    const why = place.isFar ? "The map is sure everywhere. This place is far from the other landmarks" : "Here the map is least sure";
    element("landmark-hint").textContent = `${why}: click the same place on the target.`;
  }

  // Where the map is sure everywhere: far points, which `line_order` begins with after its first.
  function firstFree(arrays, isFree) {
    const [first, ...far] = arrays.line_order ?? [];
    const vertex = [...far, first].find((each) => each !== undefined && isFree(each));
    return vertex === undefined ? null : { vertex, isFar: true };
  }

  const both = () => rows.filter(({ source, target }) => source >= 0 && target >= 0).length;

  function drawPins() {
    const pins = [];
    for (const side of ["source", "target"]) {
      rows.forEach((row, k) => {
        if (row[side] >= 0) pins.push({ side, vertex: row[side], name: row.name, row: k, colour: COLOURS[k % COLOURS.length], selected: k === selected });
      });
      if (pending[side] >= 0) pins.push({ side, vertex: pending[side], name: "?", row: -1, colour: "#ffffff", selected: true });
    }
    viewer.setPins(pins);
  }

  function draw() {
    drawPins();
    element("landmark-add").setAttribute("aria-pressed", String(adding));
    const missing = pending.source >= 0 ? "target" : pending.target >= 0 ? "source" : null;
    const hints = missing ? `Now click the same place on the ${missing}.` : "Click a place on the source and the same on the target; Esc ends.";
    element("landmark-hint").textContent = adding ? hints : rows.length ? "Drag a pin to correct it." : "";
    element("landmark-undo").disabled = !past.length;
    element("landmark-redo").disabled = !undone.length;
    element("rematch").disabled = both() < 3;
    element("rematch").textContent = both() < 3 ? `Match with landmarks (${both()} of 3)` : `Match with ${both()} landmarks`;
    element("landmark-head").hidden = !rows.length;
    const list = element("landmark-list");
    keepingFocus(list, () => list.replaceChildren(...rows.map(drawnRow)));
  }

  function drawnRow(row, k) {
    const item = document.createElement("li");
    item.classList.toggle("selected", k === selected);
    const name = Object.assign(document.createElement("input"), { type: "text", value: row.name, maxLength: 100 });
    name.setAttribute("aria-label", `Name of landmark ${row.name}`);
    name.addEventListener("change", () => {
      const wanted = name.value.trim();
      if (!wanted || rows.some((other, l) => l !== k && other.name === wanted)) {
        say(wanted ? "Another landmark has this name." : "A landmark needs a name.");
        name.value = row.name;
      } else change(() => { rows[k].name = wanted; });
    });
    const vertices = ["source", "target"].map((side) => {
      const input = Object.assign(document.createElement("input"), { type: "number", min: 0, max: pair[side].vertices - 1, value: row[side] < 0 ? "" : row[side] });
      input.setAttribute("aria-label", `Vertex of landmark ${row.name} on the ${side}`);
      input.addEventListener("change", () => {
        const vertex = input.value === "" ? -1 : Number(input.value);
        if (!Number.isInteger(vertex) || vertex >= pair[side].vertices || vertex < -1) {
          say(`The ${side} has vertices from 0 to ${pair[side].vertices - 1}.`);
          input.value = row[side] < 0 ? "" : row[side];
        } else change(() => { rows[k][side] = vertex; });
      });
      return input;
    });
    const remove = Object.assign(document.createElement("button"), { type: "button", textContent: "✕", title: "Remove" });
    remove.setAttribute("aria-label", `Remove landmark ${row.name}`);
    remove.addEventListener("click", () => change(() => { rows.splice(k, 1); selected = -1; }));
    const dot = document.createElement("i");
    dot.style.background = COLOURS[k % COLOURS.length];
    item.append(dot, name, ...vertices, remove);
    return item;
  }

  function load(side) {
    const input = element("landmark-file");
    input.onchange = async () => {
      const [file] = input.files;
      input.value = "";
      if (!file) return;
      try {
        await ask(`shapes/${pair[side].number}/landmarks?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file });
      } catch (error) {
        say(error.message);
      }
    };
    input.click();
  }

  const store = (side) => download(`shapes/${pair[side].number}/landmarks?format=${element("landmark-format").value}`);

  const listen = (id, action) => element(id).addEventListener("click", action);
  listen("landmark-add", () => setAdding(!adding));
  listen("landmark-suggest", suggest);
  listen("landmark-undo", undo);
  listen("landmark-redo", redo);
  for (const side of ["source", "target"]) {
    listen(`load-${side}`, () => load(side));
    listen(`store-${side}`, () => store(side));
  }
  window.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z" || !pair) return;
    if (event.target.tagName === "INPUT" && ["text", "number"].includes(event.target.type)) return;
    event.preventDefault();
    if (event.shiftKey) redo();
    else undo();
  });

  return { show, pick, drag, drop, suggest, setAdding, isAdding: () => adding, saved: () => saving };
}
