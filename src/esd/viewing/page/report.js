// The report of a population: sliders that deform the mean shape along its modes, and its colours.
import { css } from "esd/colours.js";
import { createViewer } from "esd/viewer.js";

const REACH = 3; // standard deviations to either side
const SWING = 2; // that play goes to
const PERIOD = 4000; // milliseconds of a swing
const element = (id) => document.getElementById(id);

function made(tag, text, attributes = {}) {
  const node = Object.assign(document.createElement(tag), attributes);
  if (text !== undefined) node.textContent = text;
  return node;
}

export function connectReport(stage, { meta, arrays }) {
  const modes = meta.explained.map((_, k) => arrays[`mode_${k + 1}`]);
  const at = new Array(modes.length).fill(0);
  let last = 0; // the mode that is played
  let playing = 0;
  const viewer = createViewer(stage, {
    point: (picked) => { element("readout").textContent = picked ? described(picked.vertex) : ""; },
  });
  viewer.load({ meta, arrays });

  function described(vertex) {
    const values = meta.fields.map((field) => `${field.title.toLowerCase()} ${viewer.valueText(field, arrays[field.name][vertex])}`);
    return [`vertex ${vertex}`, values[0]].join(" · ");
  }

  function show(text = "") {
    const positions = arrays.source_positions.slice();
    modes.forEach((mode, k) => {
      if (at[k]) for (let i = 0; i < positions.length; i++) positions[i] += at[k] * mode[i];
    });
    viewer.deform(positions);
    at.forEach((value, k) => {
      element(`mode-${k + 1}`).value = value;
      element(`mode-${k + 1}-value`).textContent = `${value > 0 ? "+" : ""}${value.toFixed(1)}`;
    });
    element("shown").textContent = text;
    for (const row of document.querySelectorAll("tr.shown")) if (row.dataset.name !== text) row.classList.remove("shown");
  }

  function stop() {
    cancelAnimationFrame(playing);
    playing = 0;
    element("play").textContent = `Play mode ${last + 1}`;
  }

  function play() {
    if (playing) return stop();
    const start = performance.now();
    const next = (now) => {
      at[last] = SWING * Math.sin((2 * Math.PI * (now - start)) / PERIOD);
      show();
      playing = requestAnimationFrame(next);
    };
    playing = requestAnimationFrame(next);
    element("play").textContent = "Stop";
    return undefined;
  }

  element("modes").replaceChildren(
    ...modes.map((_, k) => {
      const label = made("label", undefined, { className: "row" });
      const slider = made("input", undefined, { type: "range", id: `mode-${k + 1}`, min: -REACH, max: REACH, step: 0.1, value: 0 });
      slider.addEventListener("input", () => {
        last = k;
        stop();
        at[k] = Number(slider.value);
        show();
      });
      const share = made("small", ` ${(100 * meta.explained[k]).toFixed(0)} %`);
      const name = made("span", `Mode ${k + 1}`);
      name.append(share);
      label.append(name, slider, made("b", "0.0", { id: `mode-${k + 1}-value` }));
      return label;
    }),
  );

  element("mean").addEventListener("click", () => {
    stop();
    at.fill(0);
    show("mean shape");
  });
  element("play").addEventListener("click", play);
  element("reset").addEventListener("click", () => { viewer.resetView(); element("up").value = viewer.state.up; });
  element("up").value = viewer.state.up;
  element("up").addEventListener("change", () => viewer.setUp(element("up").value));

  element("colours").replaceChildren(
    ...meta.fields.map(({ name, title }) => made("option", title, { value: name })),
    made("option", "No colours", { value: "colours" }),
  );
  function paint() {
    const mode = element("colours").value;
    viewer.setMode(mode);
    const field = meta.fields.find(({ name }) => name === mode);
    element("ramp").style.background = field ? `linear-gradient(90deg, ${meta.ramp.map(css)})` : "none";
    element("lowest").textContent = field ? viewer.valueText({ ...field, unit: "" }, field.low) : "";
    element("highest").textContent = field ? viewer.valueText(field, field.high) : "";
  }
  element("colours").addEventListener("change", paint);

  for (const button of document.querySelectorAll("button[data-shape]")) {
    button.addEventListener("click", () => {
      const { name, scores } = meta.shapes[Number(button.dataset.shape)];
      stop();
      scores.forEach((value, k) => { at[k] = value; });
      const row = button.closest("tr");
      row.dataset.name = name;
      show(name);
      row.classList.add("shown");
      scrollTo({ top: 0 });
    });
  }
  paint();
  show("mean shape");
}
