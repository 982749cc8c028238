// What the page asks of the studio's server.
import { unpack } from "esd/data.js";

// The answer to a request, as JSON; an error has the server's own line.
export async function ask(path, { method = "GET", json, body } = {}) {
  const response = await answered(path, { method, body: json === undefined ? body : JSON.stringify(json) });
  return response.json();
}

export async function askScene(path) {
  const buffer = await (await answered(path)).arrayBuffer();
  const size = new DataView(buffer).getUint32(0, true);
  const meta = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  return { meta, arrays: unpack(meta.arrays, buffer, 4 + size) };
}

async function answered(path, options) {
  let response;
  try {
    response = await fetch(path, options);
  } catch {
    throw new Error("The studio does not answer. Is it still running?");
  }
  if (!response.ok) {
    const text = await response.text();
    let line = text;
    try {
      line = JSON.parse(text).error;
    } catch { /* it is the line itself */ }
    throw new Error(line || `The studio answered ${response.status}.`);
  }
  return response;
}

export function download(address, name) {
  const link = document.createElement("a");
  link.href = address;
  link.download = name ?? "";
  link.click();
}

// All files among what was dropped, those in folders too.
export async function droppedFiles(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (!entries.length) return [...transfer.files];
  return (await Promise.all(entries.map(filesOf))).flat();
}

async function filesOf(entry) {
  if (entry.isFile) return [await new Promise((done, fail) => entry.file(done, fail))];
  const reader = entry.createReader();
  const found = [];
  for (;;) { // a reader gives a hundred at a time
    const some = await new Promise((done, fail) => reader.readEntries(done, fail));
    if (!some.length) break;
    found.push(...some);
  }
  return (await Promise.all(found.map(filesOf))).flat();
}

// Let `redraw` replace what is in an element, with the focus on the control of the same name.
export function keepingFocus(node, redraw) {
  const nameOf = (control) => control.getAttribute("aria-label") ?? control.textContent;
  const name = node.contains(document.activeElement) ? nameOf(document.activeElement) : null;
  redraw();
  if (name === null) return;
  const controls = [...node.querySelectorAll("button, input, summary")];
  controls.find((control) => nameOf(control) === name)?.focus();
}
