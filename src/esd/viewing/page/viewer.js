// The page that `esd view` writes. Data come from the elements #meta and #arrays.
"use strict";
(() => {
  const element = (id) => document.getElementById(id);
  const meta = JSON.parse(element("meta").textContent);
  const arrays = readArrays(meta.arrays, element("arrays").textContent);
  element("arrays").remove();
  const { map, confidence, error, image, line_order: lineOrder } = arrays;
  const grey = meta.unmatched;
  const viewCanvas = element("view");

  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas: viewCanvas, antialias: true });
  } catch {
    document.body.innerHTML = '<p id="failure">This page needs WebGL 2, which this browser does not offer or has switched off.</p>';
    return;
  }
  THREE.ColorManagement.enabled = false; // colours are given as they shall be shown
  renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
  renderer.autoClear = false;

  const camera = new THREE.PerspectiveCamera(30, 1, 0.05, 50);
  let controls = null;
  const source = makeShape("source");
  const target = makeShape("target");
  const shapes = [source, target];
  const comesFrom = sourcesOfTargets();

  const state = { mode: "colours", lines: 0, morph: 0, up: meta.up, picked: null, kept: false };
  let frame = 0;
  let morphing = 0;

  function readArrays(layout, base64) {
    const text = atob(base64);
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    const kinds = { f4: Float32Array, u4: Uint32Array, i4: Int32Array, u1: Uint8Array };
    return Object.fromEntries(
      layout.map(([name, kind, start, count]) => [name, new kinds[kind](bytes.buffer, start, count)]),
    );
  }

  function makeShape(name) {
    const geometry = new THREE.BufferGeometry();
    const positions = arrays[name + "_positions"];
    geometry.setAttribute("position", new THREE.BufferAttribute(positions.slice(), 3));
    geometry.setIndex(new THREE.BufferAttribute(arrays[name + "_faces"], 1));
    geometry.computeVertexNormals();
    geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(positions.length), 3));
    const material = new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide });
    const mesh = new THREE.Mesh(geometry, material);
    mesh.raycast = THREE.acceleratedRaycast;
    const light = new THREE.DirectionalLight(0xffffff, 1.9);
    const scene = new THREE.Scene();
    scene.add(mesh, light, light.target, new THREE.AmbientLight(0xffffff, 1.2));
    element(name + "-name").append(name + " ", small(meta[name]));
    return { name, geometry, mesh, scene, light, positions, box: null };
  }

  function small(text) {
    const node = document.createElement("small");
    node.textContent = text;
    return node;
  }

  // For each target vertex the source vertices that are mapped to it, as one list with bounds.
  function sourcesOfTargets() {
    const start = new Uint32Array(target.positions.length / 3 + 1);
    for (const t of map) if (t >= 0) start[t + 1]++;
    for (let t = 1; t < start.length; t++) start[t] += start[t - 1];
    const next = start.slice();
    const list = new Uint32Array(start[start.length - 1]);
    map.forEach((t, i) => { if (t >= 0) list[next[t]++] = i; });
    return (t) => list.subarray(start[t], start[t + 1]);
  }

  // Colours

  function ramp(share) {
    const stops = meta.ramp;
    const at = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
    const low = Math.min(Math.floor(at), stops.length - 2);
    return [0, 1, 2].map((k) => stops[low][k] + (at - low) * (stops[low + 1][k] - stops[low][k]));
  }

  function paint() {
    const given = arrays.target_colours;
    const own = source.geometry.attributes.color;
    const other = target.geometry.attributes.color;
    const values = state.mode === "error" ? error : confidence;
    const top = state.mode === "error" ? meta.error_top : 1;
    for (let i = 0; i < map.length; i++) {
      const t = map[i];
      let colour = grey;
      if (state.mode === "colours") {
        if (t >= 0) colour = [given[3 * t] / 255, given[3 * t + 1] / 255, given[3 * t + 2] / 255];
      } else if (!Number.isNaN(values[i])) colour = ramp(values[i] / top);
      own.setXYZ(i, colour[0], colour[1], colour[2]);
    }
    for (let i = 0; i < given.length; i++) {
      other.array[i] = state.mode === "colours" ? given[i] / 255 : grey[i % 3] + 0.15;
    }
    own.needsUpdate = other.needsUpdate = true;
    element("legend").hidden = state.mode === "colours";
    element("lowest").textContent = "0";
    element("highest").textContent = state.mode === "error" ? errorText(top) + " +" : "1";
    const stops = meta.ramp.map((c) => `rgb(${c.map((x) => Math.round(255 * x)).join()})`);
    document.querySelector("#legend i").style.background = `linear-gradient(90deg, ${stops})`;
  }

  const errorText = (value) => `${(100 * value).toFixed(1)} % of √area`;

  // Layout and camera

  function resize() {
    const width = window.innerWidth;
    const height = window.innerHeight;
    const ratio = Math.min(window.devicePixelRatio, 2);
    renderer.setPixelRatio(ratio);
    renderer.setSize(width, height, false);
    const below = element("controls").offsetHeight + 20;
    const free = height - below - (width < 640 ? 60 : 0); // on phones the readout needs a place
    element("readout").style.bottom = below + "px";
    if (width >= free) {
      source.box = { x: 0, y: 0, width: width / 2, height: free };
      target.box = { x: width / 2, y: 0, width: width / 2, height: free };
    } else {
      source.box = { x: 0, y: 0, width, height: free / 2 };
      target.box = { x: 0, y: free / 2, width, height: free / 2 };
    }
    for (const shape of shapes) {
      const label = element(shape.name + "-name");
      label.style.left = shape.box.x + "px";
      label.style.top = shape.box.y + "px";
    }
    camera.aspect = source.box.width / source.box.height;
    camera.updateProjectionMatrix();
    draw();
  }

  function resetView() {
    const up = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] }[state.up];
    const eye = { x: [0, 0, 1], y: [0, 0, 1], z: [0, -1, 0] }[state.up];
    const half = Math.tan((camera.fov * Math.PI) / 360) * Math.min(1, camera.aspect);
    camera.up.set(...up);
    camera.position.set(...eye).multiplyScalar((1.12 * meta.radius) / half);
    controls?.dispose();
    controls = new THREE.OrbitControls(camera, viewCanvas); // it reads `up` only when made
    controls.addEventListener("change", draw);
    draw();
  }

  function draw() {
    if (!frame) frame = requestAnimationFrame(render);
  }

  function render() {
    frame = 0;
    renderer.setScissorTest(false);
    renderer.setClearColor(getComputedStyle(document.body).backgroundColor);
    renderer.clear();
    renderer.setScissorTest(true);
    const height = window.innerHeight;
    for (const { box, scene, light } of shapes) {
      const bottom = height - box.y - box.height;
      renderer.setViewport(box.x, bottom, box.width, box.height);
      renderer.setScissor(box.x, bottom, box.width, box.height);
      // over the viewer's left shoulder
      light.position.set(-0.5, 0.6, 1).applyQuaternion(camera.quaternion);
      renderer.render(scene, camera);
    }
    drawMarks();
    document.documentElement.dataset.ready = "true";
  }

  // Marks: lines between matched points, and the point that is looked at

  function vertexAt(shape, i) {
    return new THREE.Vector3().fromBufferAttribute(shape.geometry.attributes.position, i);
  }

  function screen(shape, point) {
    const p = point.clone().project(camera);
    return [shape.box.x + ((p.x + 1) / 2) * shape.box.width, shape.box.y + ((1 - p.y) / 2) * shape.box.height];
  }

  function facesViewer(shape, i) {
    const normal = new THREE.Vector3().fromBufferAttribute(shape.geometry.attributes.normal, i);
    return normal.dot(camera.position.clone().sub(vertexAt(shape, i))) > 0;
  }

  function isHidden(shape, i) {
    const point = vertexAt(shape, i);
    const toward = camera.position.clone().sub(point);
    const far = toward.length();
    const ray = new THREE.Raycaster(camera.position, toward.multiplyScalar(-1 / far), 0, far - 0.01);
    ray.firstHitOnly = true;
    return ray.intersectObject(withTree(shape).mesh).length > 0;
  }

  function drawMarks() {
    const parts = [];
    const colours = source.geometry.attributes.color;
    for (let k = 0; k < state.lines; k++) {
      const i = lineOrder[k];
      if (!facesViewer(source, i)) continue;
      const rgb = [colours.getX(i), colours.getY(i), colours.getZ(i)].map((c) => Math.round(255 * c));
      parts.push(line(i, map[i], `rgb(${rgb})`));
    }
    if (state.picked) {
      const sources = state.picked.sources.slice(0, 20);
      const targets = state.picked.targets;
      if (targets.length) parts.push(...sources.map((i) => line(i, targets[0], "currentColor")));
      parts.push(...sources.map((i) => dot(source, i)), ...targets.map((i) => dot(target, i)));
    }
    element("marks").innerHTML = parts.join("");
  }

  function line(from, to, colour) {
    const [x1, y1] = screen(source, vertexAt(source, from));
    const [x2, y2] = screen(target, vertexAt(target, to));
    return `<line x1="${x1}" y1="${y1}" x2="${x2}" y2="${y2}" stroke="${colour}"/>`;
  }

  // A full dot where the point is seen, a ring where something is before it.
  function dot(shape, i) {
    const [x, y] = screen(shape, vertexAt(shape, i));
    return `<circle cx="${x}" cy="${y}" r="6" fill="${isHidden(shape, i) ? "none" : "#ff8c00"}"/>`;
  }

  // Pointing

  function withTree(shape) {
    shape.geometry.boundsTree ??= new THREE.MeshBVH(shape.geometry, { indirect: true });
    return shape;
  }

  function pick(x, y) {
    const shape = shapes.find(({ box }) => x >= box.x && x < box.x + box.width && y >= box.y && y < box.y + box.height);
    if (!shape) return null;
    const { box } = shape;
    const at = new THREE.Vector2((2 * (x - box.x)) / box.width - 1, 1 - (2 * (y - box.y)) / box.height);
    const ray = new THREE.Raycaster();
    ray.setFromCamera(at, camera);
    ray.firstHitOnly = true;
    const [hit] = ray.intersectObject(withTree(shape).mesh);
    if (!hit) return null;
    const corners = [hit.face.a, hit.face.b, hit.face.c];
    const reach = corners.map((i) => vertexAt(shape, i).distanceToSquared(hit.point));
    const vertex = corners[reach.indexOf(Math.min(...reach))];
    return shape === source
      ? { side: "source", sources: [vertex], targets: map[vertex] >= 0 ? [map[vertex]] : [] }
      : { side: "target", sources: [...comesFrom(vertex)], targets: [vertex] };
  }

  function show(picked) {
    state.picked = picked;
    element("readout").textContent = picked ? describe(picked) : "";
    draw();
  }

  function describe({ side, sources, targets }) {
    if (side === "target" && sources.length !== 1) {
      const which = sources.length ? `${sources.length} source vertices` : "no source vertex";
      return `${which} → target vertex ${targets[0]}`;
    }
    const i = sources[0];
    const parts = [`source vertex ${i} → ${targets.length ? `target vertex ${targets[0]}` : "no match"}`];
    if (!Number.isNaN(confidence[i])) parts.push(`confidence ${confidence[i].toFixed(2)}`);
    if (error && !Number.isNaN(error[i])) parts.push(`error ${errorText(error[i])}`);
    return parts.join(" · ");
  }

  // Controls

  function setMode(mode) {
    const button = document.querySelector(`input[value=${mode}]`);
    if (button.disabled) return;
    button.checked = true;
    state.mode = mode;
    paint();
    resize(); // the legend changes the height of the controls
  }

  function setLines(count) {
    state.lines = Math.min(Math.max(count, 0), lineOrder.length);
    element("lines").value = state.lines;
    element("line-count").textContent = state.lines;
    draw();
  }

  function setMorph(share) {
    state.morph = share;
    element("morph").value = 100 * share;
    element("morph-share").textContent = `${Math.round(100 * share)}%`;
    const { array } = source.geometry.attributes.position;
    for (let k = 0; k < array.length; k++) array[k] = (1 - share) * source.positions[k] + share * image[k];
    source.geometry.attributes.position.needsUpdate = true;
    source.geometry.computeVertexNormals();
    source.geometry.boundsTree = undefined;
    source.geometry.computeBoundingSphere();
    draw();
  }

  function playMorph() {
    cancelAnimationFrame(morphing);
    const from = state.morph;
    const to = from < 0.5 ? 1 : 0;
    const start = performance.now();
    const step = (now) => {
      const share = Math.min((now - start) / 1200, 1);
      setMorph(from + (to - from) * share);
      if (share < 1) morphing = requestAnimationFrame(step);
    };
    morphing = requestAnimationFrame(step);
  }

  function toggleTheme() {
    const root = document.documentElement;
    const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
    draw();
  }

  function turn(around, over) {
    const offset = camera.position.clone().sub(controls.target);
    offset.applyAxisAngle(camera.up, around);
    const side = new THREE.Vector3().crossVectors(camera.up, offset).normalize();
    const tilted = offset.clone().applyAxisAngle(side, over);
    const angle = tilted.angleTo(camera.up);
    if (angle > 0.05 && angle < Math.PI - 0.05) offset.copy(tilted);
    camera.position.copy(controls.target).add(offset);
    controls.update();
    draw();
  }

  function nearer(factor) {
    camera.position.sub(controls.target).multiplyScalar(factor).add(controls.target);
    controls.update();
    draw();
  }

  const keys = {
    1: () => setMode("colours"),
    2: () => setMode("confidence"),
    3: () => setMode("error"),
    l: () => setLines(state.lines ? 0 : 60),
    "[": () => setLines(state.lines - 10),
    "]": () => setLines(state.lines + 10),
    m: playMorph,
    u: () => { state.up = { x: "y", y: "z", z: "x" }[state.up]; resetView(); },
    r: () => { state.up = meta.up; resetView(); },
    t: toggleTheme,
    "?": () => element("help").showModal(),
    Escape: () => { state.kept = false; show(null); },
    ArrowLeft: () => turn(-0.1, 0),
    ArrowRight: () => turn(0.1, 0),
    ArrowUp: () => turn(0, -0.1),
    ArrowDown: () => turn(0, 0.1),
    "+": () => nearer(0.9),
    "=": () => nearer(0.9),
    "-": () => nearer(1.1),
  };

  window.addEventListener("keydown", (event) => {
    const arrows = event.key.startsWith("Arrow") && event.target.tagName === "INPUT";
    if (event.ctrlKey || event.metaKey || event.altKey || arrows || element("help").open) return;
    const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });

  let down = null;
  viewCanvas.addEventListener("pointerdown", (event) => { down = [event.clientX, event.clientY]; });
  viewCanvas.addEventListener("pointerup", (event) => {
    if (!down || Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 6) return;
    const picked = pick(event.clientX, event.clientY);
    state.kept = picked !== null;
    show(picked);
  });
  viewCanvas.addEventListener("pointermove", (event) => {
    if (event.buttons || event.pointerType === "touch" || state.kept) return;
    show(pick(event.clientX, event.clientY));
  });
  element("controls").addEventListener("submit", (event) => event.preventDefault());
  element("modes").addEventListener("change", (event) => setMode(event.target.value));
  element("modes").addEventListener("click", (event) => {
    if (event.detail) viewCanvas.focus(); // after a press of the mouse arrows turn the shapes again
  });
  element("lines").addEventListener("input", (event) => setLines(Number(event.target.value)));
  element("morph").addEventListener("input", (event) => setMorph(Number(event.target.value) / 100));
  element("reset").addEventListener("click", keys.r);
  element("theme").addEventListener("click", toggleTheme);
  element("help-button").addEventListener("click", keys["?"]);
  window.addEventListener("resize", resize);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);

  element("lines").max = lineOrder.length;
  for (const [mode, values] of [["confidence", confidence], ["error", error]]) {
    const known = values && values.some((value) => !Number.isNaN(value));
    document.querySelector(`input[value=${mode}]`).disabled = !known;
    document.querySelector(`input[value=${mode}]`).parentElement.hidden = !known;
  }
  paint();
  resize();
  resetView();
})();
