import { embedded } from "esd/data.js";
import { connectPanel, showFailure } from "esd/panel.js";
import { createViewer, hasWebGL2 } from "esd/viewer.js";

const stage = document.getElementById("stage");
if (hasWebGL2()) {
  const readout = document.getElementById("readout");
  let update = () => {};
  const viewer = createViewer(stage, {
    change: () => update(),
    point: (picked) => { readout.textContent = picked ? viewer.describe(picked) : ""; },
  });
  update = connectPanel(viewer);
  viewer.load(embedded());
} else showFailure(stage);
