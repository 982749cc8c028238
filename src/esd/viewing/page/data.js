// Arrays as `esd.viewing.scene.Scene.packed` lays them out.

const KINDS = { f4: Float32Array, u4: Uint32Array, i4: Int32Array, u1: Uint8Array };

export function bytesOf(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes.buffer;
}

// What `esd.viewing.page.page_with` put into the page; the text of the arrays is dropped.
export function embedded() {
  const meta = JSON.parse(document.getElementById("meta").textContent);
  const text = document.getElementById("arrays");
  const arrays = unpack(meta.arrays, bytesOf(text.textContent));
  text.remove();
  return { meta, arrays };
}

// `layout` holds name, kind, first byte and length of each array; the first byte of all is `start`.
export function unpack(layout, buffer, start = 0) {
  return Object.fromEntries(
    layout.map(([name, kind, at, count]) => [name, new KINDS[kind](buffer, start + at, count)]),
  );
}
