import { bytesOf, unpack } from "esd/data.js";
import { connectPanel, showFailure } from "esd/panel.js";
import { createViewer, hasWebGL2 } from "esd/viewer.js";

const text = (id) => document.getElementById(id).textContent;
const stage = document.getElementById("stage");
if (hasWebGL2()) {
  const meta = JSON.parse(text("meta"));
  const arrays = unpack(meta.arrays, bytesOf(text("arrays")));
  document.getElementById("arrays").remove();
  const readout = document.getElementById("readout");
  let update = () => {};
  const viewer = createViewer(stage, {
    change: () => update(),
    point: (picked) => { readout.textContent = picked ? viewer.describe(picked) : ""; },
  });
  update = connectPanel(viewer);
  viewer.load({ meta, arrays });
} else showFailure(stage);
