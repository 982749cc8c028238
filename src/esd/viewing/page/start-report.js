import { bytesOf, unpack } from "esd/data.js";
import { connectReport } from "esd/report.js";
import { hasWebGL2 } from "esd/viewer.js";

const text = (id) => document.getElementById(id).textContent;
const stage = document.getElementById("stage");
if (hasWebGL2()) {
  const meta = JSON.parse(text("meta"));
  const arrays = unpack(meta.arrays, bytesOf(text("arrays")));
  document.getElementById("arrays").remove();
  connectReport(stage, { meta, arrays });
} else {
  const failure = document.createElement("p");
  failure.id = "failure";
  failure.textContent = "This browser cannot draw in three dimensions (WebGL 2); the tables are below.";
  stage.replaceChildren(failure);
}
