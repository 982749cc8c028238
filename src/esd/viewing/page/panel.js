// The controls beside the stage: verdict, what is shown, scales with histograms, worst places, keys.
import { css, histogram, quantiles, ramp } from "esd/colours.js";
import { AXES } from "esd/viewer.js";

const BINS = 40;
const element = (id) => document.getElementById(id);

function made(tag, text, attributes = {}) {
  const node = Object.assign(document.createElement(tag), attributes);
  if (text !== undefined) node.textContent = text;
  return node;
}

// Connects the elements of panel.html to a viewer. Call the result after each change of the state.
export function connectPanel(viewer, { keys: more = {} } = {}) {
  const { state } = viewer;
  let shown = null; // the scene that the elements were made for
  let distribution = null; // of the field that is shown

  function update() {
    const scene = viewer.scene();
    if (shown !== scene.meta) {
      shown = scene.meta;
      distribution = null;
      makeModes();
      makeLegend(scene.meta);
      makeSummary(scene.meta);
      makePlaces(scene.meta);
      element("lines").max = viewer.lineLimit();
    }
    element("controls").hidden = element("summary").hidden = !state.hasMap;
    const field = scene.meta.fields.find(({ name }) => name === state.mode);
    for (const input of element("modes").querySelectorAll("input")) input.checked = input.value === state.mode;
    element("pattern").value = state.pattern;
    element("pattern-label").hidden = state.mode !== "colours";
    element("scale").hidden = !field;
    if (field) drawScale(field, scene);
    element("lines").value = state.lines;
    element("line-count").textContent = state.lines;
    element("morph").value = 100 * state.morph;
    element("morph-share").textContent = `${Math.round(100 * state.morph)}%`;
    element("up").value = state.up;
    element("aligned").checked = state.aligned;
  }

  function makeModes() {
    element("modes").replaceChildren(
      made("legend", "What the colours show"),
      ...viewer.modes().map(({ name, title }) => {
        const label = made("label");
        label.append(made("input", undefined, { type: "radio", name: "mode", value: name }), made("span", title));
        return label;
      }),
    );
  }

  // What grey means, where there is any.
  function makeLegend({ lacking = [0, 0], unmatched }) {
    const text = ["source", "target"].map((side, k) => `${Math.round(100 * lacking[k])} % of the ${side}`);
    element("legend").hidden = Math.max(...lacking) < 0.005;
    element("legend").querySelector("span").textContent = `No counterpart: ${text.join(", ")}`;
    if (unmatched) element("legend").querySelector("i").style.background = css(unmatched);
  }

  function makeSummary({ verdict, statistics = [] }) {
    element("verdict").hidden = !verdict;
    element("warning").hidden = !verdict?.advice;
    if (verdict) {
      element("verdict").dataset.verdict = verdict.word;
      element("verdict").replaceChildren(made("b", verdict.word), `: ${verdict.share}`);
      element("warning").dataset.verdict = verdict.word;
      element("warning").replaceChildren(made("b", verdict.word), made("span", ` ${verdict.advice}`));
    }
    element("statistics").replaceChildren(...statistics.flatMap(([name, value]) => [made("dt", name), made("dd", value)]));
  }

  function makePlaces({ places = [], fields }) {
    element("places").hidden = !state.hasMap;
    element("no-places").hidden = places.length > 0;
    element("place-list").replaceChildren(
      ...places.map(({ vertex, field, value }) => {
        const item = made("li");
        const { unit, ...rest } = fields.find(({ name }) => name === field);
        const text = viewer.valueText({ ...rest, unit: unit.split(" ")[0] }, value);
        const button = made("button", `${field} ${text}`, { type: "button" });
        button.append(made("small", ` vertex ${vertex}`));
        button.addEventListener("click", () => viewer.fly(vertex));
        item.append(button);
        return item;
      }),
    );
  }

  function drawScale(field, { meta, arrays }) {
    if (distribution?.field !== field) {
      const values = arrays[field.name];
      const [some, most] = quantiles(values, [0.005, 0.995]);
      const low = Math.min(field.low, some);
      const high = Math.max(field.high, most);
      distribution = { field, low, high, counts: histogram(values, low, high, BINS), values };
      const step = (high - low) / 200;
      for (const id of ["lowest", "highest"]) Object.assign(element(id), { min: low, max: high, step });
    }
    const { low, high, counts } = distribution;
    const [least, most] = state.scales[field.name];
    const top = Math.max(...counts, 1);
    const bars = counts.map((count, k) => {
      const middle = low + ((k + 0.5) / BINS) * (high - low);
      const bar = document.createElementNS("http://www.w3.org/2000/svg", "rect");
      const size = count ? Math.max((40 * count) / top, 1) : 0;
      const place = { x: (200 * k) / BINS, y: 44 - size, width: 200 / BINS - 0.5, height: size };
      for (const [key, value] of Object.entries(place)) bar.setAttribute(key, value);
      bar.setAttribute("fill", css(ramp(meta.ramp, (middle - least) / (most - least || 1))));
      return bar;
    });
    element("histogram").replaceChildren(...bars);
    element("histogram").setAttribute("aria-label", `Histogram of the ${field.title.toLowerCase()}`);
    const stops = meta.ramp.map(css);
    const share = (value) => `${(100 * (value - low)) / (high - low)}%`;
    const at = stops.map((colour, k) => `${colour} ${share(least + (k / (stops.length - 1)) * (most - least))}`);
    element("ramp").style.background = `linear-gradient(90deg, ${at})`;
    element("lowest").value = least;
    element("highest").value = most;
    element("lowest-value").textContent = viewer.valueText({ ...field, unit: "" }, least);
    element("highest-value").textContent = viewer.valueText(field, most);
  }

  function fit() {
    const [least, most] = quantiles(distribution.values, [0.02, 0.98]);
    viewer.setScale(least, most > least ? most : least + 1e-3);
  }

  function fix() {
    const { low, high } = distribution.field;
    viewer.setScale(low, high);
  }

  function toggleTheme() {
    const root = document.documentElement;
    const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
    viewer.draw();
  }

  function togglePanel() {
    const hidden = document.body.classList.toggle("panel-hidden");
    element("panel-button").setAttribute("aria-expanded", String(!hidden));
  }

  let place = -1;
  function nextPlace(step) {
    const places = shown?.places ?? [];
    if (!places.length) {
      element("readout").textContent = element("no-places").textContent;
      return;
    }
    place = (place + step + places.length) % places.length;
    viewer.fly(places[place].vertex);
  }

  const keys = {
    l: () => viewer.setLines(state.lines ? 0 : 60),
    "[": () => viewer.setLines(state.lines - 10),
    "]": () => viewer.setLines(state.lines + 10),
    m: () => viewer.playMorph(),
    p: () => viewer.setPattern({ none: "checker", checker: "lines", lines: "none" }[state.pattern]),
    u: () => viewer.setUp(AXES[(AXES.indexOf(state.up) + 1) % AXES.length]),
    a: () => viewer.setAligned(!state.aligned),
    w: () => nextPlace(1),
    r: () => viewer.resetView(),
    t: toggleTheme,
    c: togglePanel,
    "?": () => element("help").showModal(),
    Escape: () => viewer.drop(),
    ArrowLeft: () => viewer.turn(-0.1, 0),
    ArrowRight: () => viewer.turn(0.1, 0),
    ArrowUp: () => viewer.turn(0, -0.1),
    ArrowDown: () => viewer.turn(0, 0.1),
    "+": () => viewer.nearer(0.9),
    "=": () => viewer.nearer(0.9),
    "-": () => viewer.nearer(1.1),
    ...more,
  };

  window.addEventListener("keydown", (event) => {
    const { tagName, type } = event.target;
    const writes = tagName === "TEXTAREA" || tagName === "SELECT" || (tagName === "INPUT" && !["radio", "range", "checkbox"].includes(type));
    const arrows = event.key.startsWith("Arrow") && tagName === "INPUT";
    if (event.ctrlKey || event.metaKey || event.altKey || arrows || writes || document.querySelector("dialog[open]")) return;
    const digit = /^[1-9]$/.test(event.key) ? Number(event.key) : 0;
    const choices = viewer.modes().map(({ name }) => name);
    const action = digit ? choices[digit - 1] && (() => viewer.setMode(choices[digit - 1])) : keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });

  const listen = (id, kind, action) => element(id).addEventListener(kind, action);
  listen("controls", "submit", (event) => event.preventDefault());
  listen("modes", "change", (event) => viewer.setMode(event.target.value));
  listen("modes", "click", (event) => {
    if (event.detail) element("view").focus({ focusVisible: false }); // arrows turn the shapes again
  });
  listen("pattern", "change", (event) => viewer.setPattern(event.target.value));
  listen("lowest", "input", (event) => viewer.setScale(Number(event.target.value), state.scales[state.mode][1]));
  listen("highest", "input", (event) => viewer.setScale(state.scales[state.mode][0], Number(event.target.value)));
  listen("fit", "click", fit);
  listen("fix", "click", fix);
  listen("lines", "input", (event) => viewer.setLines(Number(event.target.value)));
  listen("morph", "input", (event) => viewer.setMorph(Number(event.target.value) / 100));
  listen("up", "change", (event) => viewer.setUp(event.target.value));
  listen("aligned", "change", (event) => viewer.setAligned(event.target.checked));
  listen("reset", "click", keys.r);
  listen("theme", "click", toggleTheme);
  listen("help-button", "click", keys["?"]);
  listen("panel-button", "click", togglePanel);
  if (window.innerWidth < 700 || window.innerHeight < 500) togglePanel(); // phones: the shapes first
  return update;
}

export function showFailure(stage) {
  const text = "Shapes cannot be shown: this needs WebGL 2, which this browser does not offer or has switched off.";
  stage.querySelector("canvas").replaceWith(made("p", text, { id: "failure" }));
  document.documentElement.dataset.ready = "true";
}
