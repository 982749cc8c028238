import { embedded } from "esd/data.js";
import { connectReport } from "esd/report.js";
import { hasWebGL2 } from "esd/viewer.js";

const stage = document.getElementById("stage");
if (hasWebGL2()) {
  connectReport(stage, embedded());
} else {
  const failure = document.createElement("p");
  failure.id = "failure";
  failure.textContent = "This browser cannot draw in three dimensions (WebGL 2); the tables are below.";
  stage.replaceChildren(failure);
}
