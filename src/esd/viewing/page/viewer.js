// Two shapes on a stage, turned together, with their map: what is drawn and what is pointed at.
import { css, distinct, ramp } from "esd/colours.js";
import * as shapes from "esd/shape.js";

const UP = { x: [1, 0, 0], "-x": [-1, 0, 0], y: [0, 1, 0], "-y": [0, -1, 0], z: [0, 0, 1], "-z": [0, 0, -1] };
const EYE = { x: [0, 0, 1], "-x": [0, 0, 1], y: [0, 0, 1], "-y": [0, 0, 1], z: [0, -1, 0], "-z": [0, -1, 0] };
const PLAIN = [0.74, 0.77, 0.81];
const FAULT = [0.86, 0.15, 0.15];
const NEAR_PIN = 14; // pixels within which a pin is taken

const OWN = [{ name: "labels", title: "Labels" }, { name: "texture", title: "Texture" }]; // if the source has them

export const AXES = Object.keys(UP);

export function hasWebGL2() {
  return Boolean(document.createElement("canvas").getContext("webgl2"));
}

// `on` holds functions that are called: change(state), point(picked), pick(picked, event),
// drag(pin, picked), drop(pin, picked).
export function createViewer(stage, on = {}) {
  const canvas = stage.querySelector("canvas");
  const marks = stage.querySelector("svg");
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
  THREE.ColorManagement.enabled = false; // colours are given as they shall be shown
  renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
  renderer.autoClear = false;

  const camera = new THREE.PerspectiveCamera(30, 1, 0.05, 50);
  const source = shapes.makeShape("source");
  const target = shapes.makeShape("target");
  const state = {
    mode: "colours", pattern: "checker", scales: {}, lines: 0, morph: 0, up: "y", aligned: true,
    picked: null, kept: false, hasMap: false,
  };
  let meta = { fields: [] };
  let arrays = {};
  let controls = null;
  let sourcesOf = () => [];
  let pins = [];
  let marked = { source: [], target: [] };
  let frame = 0;
  let isStale = true; // the surfaces are to be drawn anew
  let moving = 0;

  // What is shown

  // `scene` holds meta and arrays; those of the target and of the map may be missing.
  function load(scene, { keepView = false } = {}) {
    const before = meta;
    ({ meta, arrays } = scene);
    meta.fields ??= [];
    for (const shape of [source, target]) {
      const positions = arrays[`${shape.name}_positions`] ?? new Float32Array(0);
      shapes.setSurface(shape, positions, arrays[`${shape.name}_faces`] ?? new Uint32Array(0));
      shape.mesh.position.set(0, 0, 0);
    }
    state.hasMap = Boolean(arrays.map);
    sourcesOf = state.hasMap ? inverse(arrays.map, shapes.count(target)) : () => [];
    if (state.hasMap) {
      shapes.setPlaces(source, target.positions, arrays.map);
      shapes.setPlaces(target, target.positions, arrays.comes_from.map((at, i) => (at < 0 ? -1 : i)));
    }
    state.scales = Object.fromEntries(meta.fields.map((f) => [f.name, [f.low, f.high]]));
    if (!modes().some(({ name }) => name === state.mode)) state.mode = "colours";
    Object.assign(state, { picked: null, kept: false, morph: 0, lines: Math.min(state.lines, lineLimit()) });
    align();
    paint();
    resize();
    if (keepView && controls && before.source === meta.source && before.target === meta.target) draw();
    else {
      state.up = meta.up;
      resetView();
    }
    changed();
  }

  const lineLimit = () => arrays.line_order?.length ?? 0;

  function inverse(map, size) {
    const start = new Uint32Array(size + 1);
    for (const t of map) if (t >= 0) start[t + 1]++;
    for (let t = 1; t < start.length; t++) start[t] += start[t - 1];
    const next = start.slice();
    const list = new Uint32Array(start[start.length - 1]);
    map.forEach((t, i) => { if (t >= 0) list[next[t]++] = i; });
    return (t) => list.subarray(start[t], start[t + 1]);
  }

  function changed() {
    on.change?.(state);
  }

  // What the colours may show: places on the target, values of the map, and what the source has.
  function modes() {
    return [{ name: "colours", title: "Colours" }, ...meta.fields, ...OWN.filter(({ name }) => arrays[name])];
  }

  function fieldOf(mode) {
    return meta.fields.find((field) => field.name === mode);
  }

  function paint() {
    const field = fieldOf(state.mode);
    for (const shape of [source, target]) {
      const { color } = shape.mesh.geometry.attributes;
      if (!color) continue; // nothing is loaded yet
      for (let i = 0; i < color.count; i++) color.setXYZ(i, ...colourAt(field, shape, i));
      for (const i of marked[shape.name]) if (i < color.count) color.setXYZ(i, ...FAULT);
      color.needsUpdate = true;
      const on = state.hasMap && state.mode === "colours";
      shape.uniforms.pattern.value = on ? shapes.PATTERNS.indexOf(state.pattern) : 0;
    }
    draw();
  }

  function colourAt(field, shape, i) {
    if (!state.hasMap && !field && !arrays[state.mode]) return PLAIN;
    const at = shape === source ? i : arrays.comes_from?.[i] ?? -1; // a source vertex
    const isOwn = shape === source && OWN.some(({ name }) => name === state.mode);
    if (at < 0 || (!isOwn && arrays.map?.[at] < 0)) return meta.unmatched; // no counterpart
    if (field) return valueColour(field, at);
    if (state.mode === "labels") return arrays.labels[at] < 0 ? meta.unmatched : distinct(arrays.labels[at]);
    const [from, k] = state.mode === "texture" ? [arrays.texture, at] : [arrays.target_colours, shape === source ? arrays.map[i] : i];
    return [from[3 * k] / 255, from[3 * k + 1] / 255, from[3 * k + 2] / 255];
  }

  function valueColour(field, at) {
    const value = arrays[field.name][at];
    if (Number.isNaN(value)) return meta.unmatched;
    const [low, high] = state.scales[field.name];
    return ramp(meta.ramp, (value - low) / (high - low || 1));
  }

  function align() {
    const turned = state.aligned && meta.rotation;
    shapes.move(target, turned ? shapes.rotated(target.positions, meta.rotation) : target.positions);
    target.mesh.position.set(0, 0, 0);
    draw();
  }

  // Layout and camera

  function resize() {
    const width = stage.clientWidth;
    const height = stage.clientHeight;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    renderer.setSize(width, height, false);
    if (!shapes.count(target)) {
      source.box = { x: 0, y: 0, width, height };
      target.box = { x: width, y: 0, width: 0, height };
    } else if (width >= height) {
      source.box = { x: 0, y: 0, width: width / 2, height };
      target.box = { x: width / 2, y: 0, width: width / 2, height };
    } else {
      source.box = { x: 0, y: 0, width, height: height / 2 };
      target.box = { x: 0, y: height / 2, width, height: height / 2 };
    }
    for (const { name, box } of [source, target]) {
      const label = stage.querySelector(`#${name}-name`);
      const text = document.createElement("small");
      text.textContent = meta[name] ?? "";
      label.replaceChildren(`${name} `, text);
      label.hidden = !box.width || !meta.source;
      label.style.left = `${box.x}px`;
      label.style.top = `${box.y}px`;
      label.style.maxWidth = `${box.width}px`;
    }
    const before = distance();
    camera.aspect = Math.max(source.box.width, 1) / Math.max(source.box.height, 1);
    camera.updateProjectionMatrix();
    if (controls) nearer(distance() / before); // what was seen is still seen where a box is narrower
    controls?.handleResize();
    draw();
  }

  function distance() {
    const half = Math.tan((camera.fov * Math.PI) / 360) * Math.min(1, camera.aspect);
    return (1.12 * (meta.radius ?? 1)) / half;
  }

  function resetView() {
    cancelAnimationFrame(moving);
    target.mesh.position.set(0, 0, 0);
    camera.up.set(...UP[state.up]);
    camera.position.set(...EYE[state.up]).multiplyScalar(distance());
    controls?.dispose();
    controls = new THREE.TrackballControls(camera, canvas);
    Object.assign(controls, { staticMoving: true, rotateSpeed: 3, zoomSpeed: 1, panSpeed: 0.6, keys: ["", "", ""] });
    draw();
  }

  function turn(around, over) {
    const offset = camera.position.clone().sub(controls.target);
    const side = new THREE.Vector3().crossVectors(camera.up, offset).normalize();
    for (const [axis, angle] of [[camera.up.clone().normalize(), around], [side, over]]) {
      offset.applyAxisAngle(axis, angle);
      camera.up.applyAxisAngle(axis, angle);
    }
    camera.position.copy(controls.target).add(offset);
    draw();
  }

  function nearer(factor) {
    camera.position.sub(controls.target).multiplyScalar(factor).add(controls.target);
    draw();
  }

  // Look at a source vertex from outside, with its image at the same place.
  function fly(i) {
    if (state.morph) setMorph(0);
    const t = state.hasMap ? arrays.map[i] : -1;
    target.mesh.position.set(0, 0, 0);
    if (t >= 0) target.mesh.position.subVectors(shapes.vertexAt(source, i), shapes.vertexAt(target, t));
    state.kept = true;
    flyTo("source", i);
  }

  // Look at a vertex of a shape from outside.
  function flyTo(side, i) {
    const shape = side === "source" ? source : target;
    if (side === "target") target.mesh.position.set(0, 0, 0);
    const point = shapes.vertexAt(shape, i);
    const outward = shapes.normalAt(shape, i);
    const from = { at: controls.target.clone(), eye: camera.position.clone(), up: camera.up.clone() };
    const to = { at: point, eye: point.clone().addScaledVector(outward, 0.45 * distance()), up: new THREE.Vector3(...UP[state.up]) };
    if (Math.abs(to.up.dot(outward)) > 0.95) to.up.set(...EYE[state.up]);
    animate(500, (share) => {
      controls.target.lerpVectors(from.at, to.at, share);
      camera.position.lerpVectors(from.eye, to.eye, share);
      camera.up.lerpVectors(from.up, to.up, share).normalize();
    });
    show(pickedAt(shape, i));
  }

  function animate(duration, step) {
    cancelAnimationFrame(moving);
    const start = performance.now();
    const length = matchMedia("(prefers-reduced-motion: reduce)").matches ? 1 : duration;
    const next = (now) => {
      const share = Math.min(Math.max((now - start) / length, 0), 1);
      step(share * share * (3 - 2 * share));
      draw();
      if (share < 1) moving = requestAnimationFrame(next);
    };
    moving = requestAnimationFrame(next);
  }

  // Draw all before the next picture of the browser.
  function draw() {
    isStale = true;
    drawPoints();
  }

  // Draw the marks anew, and the surfaces only if they changed: pointing at large meshes is quick.
  function drawPoints() {
    if (!frame) frame = requestAnimationFrame(render);
  }

  function updateCamera() {
    controls?.update();
    camera.updateMatrixWorld();
  }

  function render() {
    frame = 0;
    if (isStale) {
      isStale = false;
      updateCamera();
      paintStage(getComputedStyle(document.body).backgroundColor, 1);
    }
    drawMarks();
    document.documentElement.dataset.ready = "true";
  }

  function paintStage(background, opacity) {
    renderer.setScissorTest(false);
    renderer.setClearColor(background, opacity);
    renderer.clear();
    renderer.setScissorTest(true);
    for (const shape of [source, target]) {
      const { box, scene, light } = shape;
      // drawn without normals once, a shape would be shaded flat ever after
      if (!box?.width || !shapes.count(shape)) continue;
      const bottom = stage.clientHeight - box.y - box.height;
      renderer.setViewport(box.x, bottom, box.width, box.height);
      renderer.setScissor(box.x, bottom, box.width, box.height);
      // over the viewer's left shoulder
      light.position.set(-0.5, 0.6, 1).applyQuaternion(camera.quaternion);
      renderer.render(scene, camera);
    }
  }

  // A PNG of the stage without a background.
  function picture() {
    paintStage("#000000", 0);
    const done = new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
    draw();
    return done;
  }

  // Marks: lines between matched points, pins, and the point that is looked at

  function screen(shape, point) {
    const p = point.clone().project(camera);
    return [shape.box.x + ((p.x + 1) / 2) * shape.box.width, shape.box.y + ((1 - p.y) / 2) * shape.box.height];
  }

  function drawMarks() {
    const parts = [];
    const { color } = source.mesh.geometry.attributes;
    for (let k = 0; k < state.lines; k++) {
      const i = arrays.line_order[k];
      if (!shapes.facesViewer(source, i, camera)) continue;
      parts.push(line(i, arrays.map[i], css([color.getX(i), color.getY(i), color.getZ(i)])));
    }
    if (state.picked) {
      const from = state.picked.sources.slice(0, 20);
      const to = state.picked.targets;
      if (to.length) parts.push(...from.map((i) => line(i, to[0], "currentColor")));
      parts.push(...from.map((i) => dot(source, i, "#ff8c00")), ...to.map((i) => dot(target, i, "#ff8c00")));
    }
    for (const pin of pins) parts.push(...drawnPin(pin));
    marks.replaceChildren(...parts);
  }

  function node(name, attributes, text) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    return made;
  }

  function line(from, to, colour) {
    const [x1, y1] = screen(source, shapes.vertexAt(source, from));
    const [x2, y2] = screen(target, shapes.vertexAt(target, to));
    return node("line", { x1, y1, x2, y2, stroke: colour });
  }

  // A full dot where the point is seen, a ring where something is before it.
  function dot(shape, i, colour) {
    const [cx, cy] = screen(shape, shapes.vertexAt(shape, i));
    return node("circle", { cx, cy, r: 6, fill: shapes.isHidden(shape, i, camera) ? "none" : colour });
  }

  function drawnPin(pin) {
    const shape = pin.side === "source" ? source : target;
    if (!shape.box?.width || pin.vertex < 0 || pin.vertex >= shapes.count(shape)) return [];
    const [x, y] = screen(shape, shapes.vertexAt(shape, pin.vertex));
    const made = dot(shape, pin.vertex, pin.colour);
    made.setAttribute("class", pin.selected ? "pin selected" : "pin");
    return [made, node("text", { x: x + 9, y: y - 7 }, pin.name)];
  }

  // Pointing

  function boxAt(x, y) {
    const inside = ({ box }) => box?.width && x >= box.x && x < box.x + box.width && y >= box.y && y < box.y + box.height;
    return [source, target].find(inside);
  }

  function pick(x, y) {
    const shape = boxAt(x, y);
    if (!shape) return null;
    if (isStale) updateCamera(); // it moved since what is seen was drawn
    const { box } = shape;
    const at = new THREE.Vector2((2 * (x - box.x)) / box.width - 1, 1 - (2 * (y - box.y)) / box.height);
    const ray = new THREE.Raycaster();
    ray.setFromCamera(at, camera);
    const vertex = shapes.hitVertex(shape, ray);
    return vertex === null ? null : pickedAt(shape, vertex);
  }

  function pickedAt(shape, vertex) {
    if (shape === target) return { side: "target", vertex, sources: [...sourcesOf(vertex)], targets: [vertex] };
    const t = state.hasMap ? arrays.map[vertex] : -1;
    return { side: "source", vertex, sources: [vertex], targets: t >= 0 ? [t] : [] };
  }

  function pinAt(x, y) {
    const shape = boxAt(x, y);
    const reach = ({ side, vertex }) => {
      if (!shape || side !== shape.name || vertex < 0) return Infinity;
      const [px, py] = screen(shape, shapes.vertexAt(shape, vertex));
      return Math.hypot(px - x, py - y);
    };
    const near = pins.filter((pin) => reach(pin) < NEAR_PIN).sort((a, b) => reach(a) - reach(b));
    return near.find((pin) => !shapes.isHidden(shape, pin.vertex, camera)) ?? near[0] ?? null;
  }

  function show(picked) {
    state.picked = picked;
    on.point?.(picked);
    drawPoints();
  }

  function describe({ side, vertex, sources, targets }) {
    if (!state.hasMap) return `${side} vertex ${vertex}`;
    if (side === "target" && sources.length !== 1) {
      const which = sources.length ? `${sources.length} source vertices` : "no source vertex";
      return `${which} → target vertex ${vertex}`;
    }
    const i = sources[0];
    const label = arrays.labels?.[i] ?? -1;
    const named = label < 0 ? [] : [`label ${meta.names?.[label] ?? label}`];
    const parts = [`source vertex ${i} → ${targets.length ? `target vertex ${targets[0]}` : "no counterpart"}`];
    for (const field of meta.fields) {
      const value = arrays[field.name][i];
      if (!Number.isNaN(value) && targets.length) parts.push(`${field.title.toLowerCase()} ${valueText(field, value)}`);
    }
    return [...parts, ...named].join(" · ");
  }

  function valueText(field, value) {
    const shown = field.factor * value;
    const digits = field.factor > 1 ? 1 : 2;
    return `${shown.toFixed(digits)}${field.unit && ` ${field.unit}`}`;
  }

  // Settings

  function setMode(mode) {
    if (!modes().some(({ name }) => name === mode)) return;
    state.mode = mode;
    paint();
    changed();
  }

  function setScale(low, high) {
    state.scales[state.mode] = [low, high];
    paint();
    changed();
  }

  function setPattern(pattern) {
    state.pattern = pattern;
    paint();
    changed();
  }

  function setLines(lines) {
    state.lines = Math.min(Math.max(lines, 0), lineLimit());
    drawPoints();
    changed();
  }

  function setMorph(share) {
    if (!arrays.image) return;
    state.morph = share;
    shapes.move(source, source.positions.map((x, k) => (1 - share) * x + share * arrays.image[k]));
    draw();
    changed();
  }

  // Move the source's vertices; it stays what it was.
  function deform(positions) {
    shapes.move(source, positions);
    draw();
  }

  function playMorph() {
    const from = state.morph;
    const to = from < 0.5 ? 1 : 0;
    animate(1200, (share) => setMorph(from + (to - from) * share));
  }

  function setUp(axis) {
    state.up = axis;
    resetView();
    changed();
  }

  function setAligned(aligned) {
    state.aligned = aligned;
    align();
    changed();
  }

  function setPins(list) {
    pins = list;
    drawPoints();
  }

  // Vertices that are marked, by name of the shape.
  function mark(lists) {
    marked = { source: [], target: [], ...lists };
    paint();
  }

  // Events

  let down = null;
  let held = null; // the pin that is dragged
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  canvas.addEventListener("pointerdown", (event) => {
    down = place(event);
    held = on.drag && event.button === 0 ? pinAt(...down) : null;
    if (held) event.stopImmediatePropagation(); // the camera stays
  }, { capture: true });
  canvas.addEventListener("pointermove", (event) => {
    const at = place(event);
    if (held) {
      const picked = pick(...at);
      if (picked?.side === held.side) on.drag(held, picked.vertex);
    } else if (event.buttons || event.pointerType === "touch") draw();
    else if (!state.kept) show(pick(...at));
  });
  canvas.addEventListener("pointerup", (event) => {
    const at = place(event);
    const still = down && Math.hypot(at[0] - down[0], at[1] - down[1]) <= 6;
    if (held) {
      const pin = held;
      held = null;
      on.drop?.(pin, still);
      return;
    }
    if (!still || event.button !== 0) return;
    const picked = pick(...at);
    if (on.pick?.(picked, event)) return;
    state.kept = picked !== null;
    show(picked);
  });
  canvas.addEventListener("pointerleave", () => { if (!state.kept) show(null); });
  canvas.addEventListener("wheel", draw);
  new ResizeObserver(resize).observe(stage);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);

  return {
    state, load, setMode, setScale, setPattern, setLines, setMorph, deform, playMorph, setUp, setAligned, setPins, mark,
    resetView: () => { state.up = meta.up; resetView(); changed(); },
    drop: () => { state.kept = false; show(null); },
    turn, nearer, fly, flyTo, pick, pinAt, picture, describe, valueText, draw, lineLimit,
    modes,
    scene: () => ({ meta, arrays }),
    screenOf: (side, vertex) => {
      const shape = side === "source" ? source : target;
      return screen(shape, shapes.vertexAt(shape, vertex));
    },
  };
}
